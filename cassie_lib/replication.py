"""What another training of everything gives: its records beside the stored ones, claim by claim.

Intervals cover the starts of trials and the sampling of plans.  What another run of
``make figures RECOMPUTE=all`` changes is told by its ``results.json``, copied to
``figures/replicates`` under a name that becomes the heading of its column.

``python -m cassie_lib.replication FILE`` prints the records of this checkout beside those of
another ``results.json``.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from cassie_lib import paths
from cassie_lib.errors import CassieError
from cassie_lib.results import claim_of, markdown_table, ours, read_records, read_results

#: What hangs on the machine and on what else it computes: time, not skill.
_MEASURES_OF_TIME = frozenset({"h", "ms"})


def replicates_table() -> str:
    """Markdown table: the ``laptop`` records beside those of every replicate.

    Raises:
        DataError: If a file of records cannot be read.
    """
    files = sorted((paths.FIGURES / "replicates").glob("*.json"))
    others = {file.stem.replace("-", " "): read_records(file) for file in files}
    return comparison(read_results("laptop"), others)


def comparison(here: list[dict[str, Any]], others: dict[str, list[dict[str, Any]]]) -> str:
    """Markdown table of records beside others of the same claims; times are left out.

    A verdict stands in the other's cell where it is not the one here.

    Args:
        here: Records of the first column.
        others: Records of the further columns, by their heading.
    """
    rows = []
    for record in here:
        if record["unit"] in _MEASURES_OF_TIME:
            continue
        verdict = f": {record['verdict']}" if record["thesis_value"] is not None else ""
        row = [record["figure"], claim_of(record) + verdict, ours(record)]
        for records in others.values():
            same = [item for item in records if item["id"] == record["id"]]
            row.append(_beside(record, same[0]) if same else "–")
        rows.append(row)
    return markdown_table(["Thesis", "Claim", "here", *others], rows)


def _beside(record: dict[str, Any], other: dict[str, Any]) -> str:
    differs = record["verdict"] != other["verdict"]
    return ours(other) + (f": **{other['verdict']}**" if differs else "")


def main(arguments: list[str] | None = None) -> int:
    """Run ``python -m cassie_lib.replication``; returns the exit code."""
    words = sys.argv[1:] if arguments is None else arguments
    if len(words) != 1:
        print("usage: python -m cassie_lib.replication FILE", file=sys.stderr)
        return 2
    file = Path(words[0])
    try:
        print(comparison(read_results("laptop"), {file.name: read_records(file)}), end="")
    except CassieError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


__all__ = ["comparison", "replicates_table"]

if __name__ == "__main__":
    sys.exit(main())
