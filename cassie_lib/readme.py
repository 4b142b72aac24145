"""The README's generated tables: each stands between two marks and is written anew from records."""

from __future__ import annotations

from collections.abc import Callable

from cassie_lib import paths
from cassie_lib.errors import DataError
from cassie_lib.files import write_text
from cassie_lib.replication import replicates_table
from cassie_lib.results import results_table

#: Name in the marks -> what writes the table.
TABLES: dict[str, Callable[[], str]] = {"results": results_table, "replicates": replicates_table}


def split_at_marks(text: str, name: str) -> tuple[str, str, str]:
    """Parts of a text before, between and after ``<!-- name:begin -->`` and ``<!-- name:end -->``.

    The marks belong to the first and the last part.

    Raises:
        DataError: If one of them is missing.
    """
    begin, end = f"<!-- {name}:begin -->", f"<!-- {name}:end -->"
    before, first, rest = text.partition(begin)
    inside, second, after = rest.partition(end)
    if not first or not second:
        raise DataError(f"{paths.README.name} lacks a mark: expected {begin} and then {end}")
    return before + begin, inside, end + after


def update_readme() -> bool:
    """Write the README's tables anew; returns whether anything changed.

    Raises:
        DataError: If the README lacks a mark or a file of records cannot be read.
    """
    text = updated = paths.README.read_text(encoding="utf-8")
    for name, table in TABLES.items():
        before, _, after = split_at_marks(updated, name)
        updated = f"{before}\n\n{table()}\n{after}"
    if updated != text:
        write_text(paths.README, updated)
    return updated != text


__all__ = ["TABLES", "split_at_marks", "update_readme"]
