"""One style for all figures; each is saved with the data that it shows and where they come from.

``python -m cassie_lib.figures readme`` writes the README's tables of results anew.
"""

from __future__ import annotations

import csv
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cassie_lib import paths
from cassie_lib.errors import CassieError, ParameterError, ShapeError
from cassie_lib.files import replacing, write_json
from cassie_lib.intervals import bootstrap_interval
from cassie_lib.provenance import Provenance, provenance_line
from cassie_lib.readme import update_readme
from cassie_lib.results import read_results, record_result, results_table

#: Width of the thesis's text column, in inches.
COLUMN_WIDTH_IN = 5.9
#: Okabe and Ito's colours: told apart with every common colour blindness.
COLOURS = {
    "blue": "#0072B2",
    "orange": "#E69F00",
    "green": "#009E73",
    "vermillion": "#D55E00",
    "purple": "#CC79A7",
    "sky": "#56B4E9",
    "black": "#000000",
}
_LINES = ("-", "--", "-.", ":", (0, (5, 1)), (0, (3, 1, 1, 1)), (0, (1, 1)))
_NAME = re.compile(r"[a-z0-9]+([-_.][a-z0-9]+)*")


def use_style() -> None:
    """Set matplotlib's defaults: thesis column width, Okabe-Ito colours, lines told apart in grey.

    A figure made afterwards without a size is one column (5.9 in) wide.
    """
    import matplotlib as mpl
    from cycler import cycler

    cycle = cycler(color=list(COLOURS.values())) + cycler(linestyle=list(_LINES))
    style: dict[str, Any] = {
        "figure.figsize": (COLUMN_WIDTH_IN, 3.2),
        "figure.dpi": 110,
        "figure.constrained_layout.use": True,
        "savefig.dpi": 200,
        "font.size": 8.5,
        "axes.titlesize": 9,
        "axes.labelsize": 8.5,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "axes.prop_cycle": cycle,
        "grid.alpha": 0.3,
        "grid.linewidth": 0.5,
        "lines.linewidth": 1.3,
        "legend.fontsize": 7.5,
        "legend.frameon": False,
        "xtick.labelsize": 7.5,
        "ytick.labelsize": 7.5,
        "pdf.fonttype": 42,
    }
    mpl.rcParams.update(style)


class SavedFigure(dict[str, Path]):
    """Paths of a figure's files by kind; shown in a notebook as one line."""

    def __repr__(self) -> str:
        """Name the files once, then their endings."""
        picture = self["png"]
        inside = picture.is_relative_to(paths.ROOT)
        shown = picture.relative_to(paths.ROOT) if inside else picture
        endings = " ".join(path.suffix for path in self.values())
        return f"saved {shown.with_suffix('').as_posix()} {endings}"


def save_figure(
    figure: Any, name: str, data: Mapping[str, Any], provenance: Provenance
) -> SavedFigure:
    """Save a figure as PNG and PDF, the data that it shows, and its provenance beside it.

    An unchanged ``laptop`` run writes to ``figures/``; smoke tests and trials with changed
    parameters write to the cache, so they never replace a figure of the README.

    Args:
        figure: A matplotlib figure.
        name: File name without ending, e.g. ``"05-prediction-error"``.
        data: The plotted numbers: columns of one length (CSV), ``{series: {column: values}}``
            (one CSV with a first column ``series``), or arrays of any shape (npz).
        provenance: From :meth:`~cassie_lib.provenance.Provenance.of`.

    Returns:
        Paths by kind: ``"png"``, ``"pdf"``, ``"data"``, ``"provenance"``.

    Raises:
        ParameterError: If the name is not lower-case letters, digits and ``- _ .``.
        ShapeError: If there are no data or the columns of a series differ in length.
    """
    if not _NAME.fullmatch(name):
        raise ParameterError(f"figure name is {name!r}: expected a form like '05-prediction'")
    folder = paths.figures_folder(provenance.preset, bool(provenance.changed))
    places = SavedFigure(png=folder / f"{name}.png", pdf=folder / f"{name}.pdf")
    places["data"] = write_plotted_data(folder, name, data)
    if provenance.preset == "smoke":
        figure.text(0.5, 0.5, "smoke test", fontsize=30, alpha=0.15, ha="center", va="center")
    # Without a date the same data give the same file.
    about: dict[str, Any] = {
        "png": {"Description": provenance.line()},
        "pdf": {"Subject": provenance.line(), "CreationDate": None},
    }
    for kind in ("png", "pdf"):
        with replacing(places[kind]) as temporary:
            figure.savefig(temporary, metadata=about[kind])
    places["provenance"] = folder / f"{name}.json"
    write_json(places["provenance"], {"figure": name, **provenance.record()})
    return places


def write_plotted_data(folder: Path, name: str, data: Mapping[str, Any]) -> Path:
    """Write plotted numbers as ``name.csv`` (tables) or ``name.npz`` (arrays); see save_figure.

    Raises:
        ShapeError: If there are no data or the columns of a series differ in length.
    """
    if not data:
        raise ShapeError(f"figure {name} comes without data: expected the numbers that it shows")
    nested = all(isinstance(item, Mapping) for item in data.values())
    if not nested:
        arrays = {key: np.asarray(item) for key, item in data.items()}
        if any(item.ndim != 1 for item in arrays.values()):
            target = folder / f"{name}.npz"
            with replacing(target) as temporary:
                np.savez_compressed(temporary, allow_pickle=False, **arrays)
            (folder / f"{name}.csv").unlink(missing_ok=True)
            return target
    tables = data if nested else {"": data}
    header = list(dict.fromkeys(column for table in tables.values() for column in table))
    rows = [row for series, table in tables.items() for row in _rows(name, series, table, header)]
    target = folder / f"{name}.csv"
    with replacing(target) as temporary, open(temporary, "w", newline="", encoding="utf-8") as f:
        writer = csv.writer(f, lineterminator="\n")
        writer.writerow((["series"] if nested else []) + header)
        writer.writerows(rows)
    (folder / f"{name}.npz").unlink(missing_ok=True)
    return target


def _rows(name: str, series: str, table: Mapping[str, Any], header: list[str]) -> list[list[Any]]:
    columns = {key: np.asarray(values).tolist() for key, values in table.items()}
    lengths = {key: len(values) for key, values in columns.items()}
    if len(set(lengths.values())) > 1:
        raise ShapeError(f"data {series!r} of figure {name}: expected one length, got {lengths}")
    first = [series] if series else []
    count = next(iter(lengths.values()), 0)
    return [
        first + [_text(columns[key][row]) if key in columns else "" for key in header]
        for row in range(count)
    ]


def _text(value: Any) -> Any:
    return f"{value:.9g}" if isinstance(value, float) else value


def main(arguments: list[str] | None = None) -> int:
    """Run ``python -m cassie_lib.figures readme``; returns the exit code."""
    words = sys.argv[1:] if arguments is None else arguments
    if words != ["readme"]:
        print("usage: python -m cassie_lib.figures readme", file=sys.stderr)
        return 2
    try:
        print("README.md: tables " + ("written" if update_readme() else "are up to date"))
    except CassieError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


__all__ = [
    "COLOURS",
    "COLUMN_WIDTH_IN",
    "Provenance",
    "bootstrap_interval",
    "provenance_line",
    "read_results",
    "record_result",
    "results_table",
    "save_figure",
    "update_readme",
    "use_style",
    "write_plotted_data",
]

if __name__ == "__main__":
    sys.exit(main())
