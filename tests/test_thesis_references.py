"""Every equation, algorithm, table and figure of the thesis is found by text search."""

import re

import pytest

from cassie_lib import paths

#: Figures 1.1, 2.1, 3.1, 4.1 and 4.2 are drawings or photographs that no notebook rebuilds; of
#: these the README names the ones that a notebook explains.
_NAMES = "4.3 4.4 5.1 5.2 5.3 5.4 5.5 5.6 5.7 5.8 6.1 A.1 A.2"
REBUILT = [f"Figure {name}" for name in _NAMES.split()]
EQUATIONS = [f"Eq 3.{number}" for number in range(1, 12)]
OTHERS = ["Algorithm 1", "Algorithm 2", "Algorithm 3", "Table 4.1", "Appendix A.1", "Appendix A.3"]


def _text(files):
    joined = "\n".join(path.read_text(encoding="utf-8") for path in sorted(files))
    # "Eqs 3.4, 3.5 and 3.6" and "Figures 5.1 and 5.2" name each of their members.
    for plural, single in (("Eqs", "Eq"), ("Figures", "Figure")):
        for found in re.findall(rf"{plural} ((?:[\dA]\.\d+(?:, | and | to )?)+)", joined):
            joined += "".join(f"\n{single} {n}" for n in re.findall(r"[\dA]\.\d+", found))
    return joined


@pytest.fixture(scope="module")
def texts():
    return {
        "library": _text(paths.PACKAGE.rglob("*.py")),
        "notebooks": _text(paths.NOTEBOOKS.glob("*.ipynb")),
        "readme": _text([paths.ROOT / "README.md"]),
    }


def _names(text, reference):
    return re.search(re.escape(reference) + r"(?!\d)", text) is not None


@pytest.mark.parametrize("reference", REBUILT)
def test_figures_are_named_in_a_notebook_and_in_the_readme(texts, reference):
    assert _names(texts["notebooks"], reference)
    assert _names(texts["readme"], reference)


@pytest.mark.parametrize("reference", EQUATIONS + OTHERS)
def test_equations_algorithms_and_tables_are_named(texts, reference):
    assert _names(texts["library"] + texts["notebooks"], reference)
    assert _names(texts["readme"], reference)
