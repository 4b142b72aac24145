"""Versions of a source file that are known to make the same bits.

A file made faster is another file, and everything it has ever made would be said to rest on older
code.  Where tests prove that two versions make the same bits, the older one counts as the present
one.  The proof stays in the test suite; any further change of the file brings the notices back.
"""

from __future__ import annotations

#: File -> the version that equals others, and those: fingerprints of
#: :func:`~cassie_lib.code_version.file_fingerprint`.  The test that both pass is named beside it.
EQUAL: dict[str, tuple[str, frozenset[str]]] = {
    # tests/test_simulator_bits.py: controls and results of a control step in standing buffers.
    "simulator.py": ("cc3eefb0fed8b758", frozenset({"d9583af43eb8121f"})),
    # tests/test_planning_resume.py: planned episodes may be killed, and go on to the same end.
    "planning/cem.py": ("980d35e38ee28763", frozenset({"119c481394178a8c"})),
    "planning/control.py": ("fe220ffa6f99a056", frozenset({"bc1e566ba295b80b"})),
    "planning/evaluate.py": ("79b1f4048d4b51e7", frozenset({"4a20943370535c39"})),
}


def same_code(name: str, made: str | None, now: str | None) -> bool:
    """Whether two versions of a source file make the same bits.

    Args:
        name: Path of the file below the package.
        made: Fingerprint of the version that made a result; None if it had no such file.
        now: Fingerprint of the present version; None if there is none.
    """
    present, older = EQUAL.get(name, ("", frozenset()))
    return made == now or (now == present and made in older)


__all__ = ["EQUAL", "same_code"]
