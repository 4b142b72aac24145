"""What another training of everything gives: its records beside the stored ones, claim by claim.

Intervals cover the starts of trials and the sampling of plans.  What another run of
``make figures RECOMPUTE=all`` changes is told by its records, kept as a file of
``figures/replicates``.

``python -m cassie_lib.replication keep TITLE`` keeps the records of a checkout in which everything
was made anew; ``python -m cassie_lib.replication compare FILE`` prints its records beside those of
another ``results.json``.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

from cassie_lib import paths
from cassie_lib.errors import CassieError, DataError, ParameterError
from cassie_lib.files import write_json
from cassie_lib.results import ours, read_records, read_results

#: What hangs on the machine and on what else it computes: time, not skill.
_MEASURES_OF_TIME = frozenset({"h", "ms"})
_TITLE = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ,.-]*")


def replicate_file(title: str) -> Path:
    """Where the records of a replicate are kept.

    Raises:
        ParameterError: If the title has other characters than letters, digits and ``, . -``.
    """
    if not _TITLE.fullmatch(title):
        raise ParameterError(f"title is {title!r}: expected letters, digits, spaces and , . -")
    return paths.FIGURES / "replicates" / (re.sub(r"[^a-z0-9]+", "-", title.lower()) + ".json")


def keep_replicate(title: str) -> Path:
    """Keep the present ``laptop`` records as those of another training.

    Args:
        title: Its column in the README, e.g. ``"on a third processor"``.

    Returns:
        The file that was written.

    Raises:
        ParameterError: If the title cannot name a file.
        DataError: If there are no records.
    """
    target, records = replicate_file(title), read_results("laptop")
    if not records:
        raise DataError("there are no laptop results to keep: expected those of make figures")
    write_json(target, {"title": title, "results": records})
    return target


def read_replicates() -> dict[str, list[dict[str, Any]]]:
    """Records of every kept replicate by title, in the order of the files' names.

    Raises:
        DataError: If a file cannot be read.
    """
    found: dict[str, list[dict[str, Any]]] = {}
    for file in sorted((paths.FIGURES / "replicates").glob("*.json")):
        try:
            kept = json.loads(file.read_text(encoding="utf-8"))
            records = sorted(kept["results"], key=lambda record: record["id"])
            found[str(kept["title"])] = records
        except (ValueError, KeyError, TypeError):
            raise DataError(f"{file.name} cannot be read: expected a title and results") from None
    return found


def replicates_table() -> str:
    """Markdown table: the stored ``laptop`` records beside those of every replicate.

    Raises:
        DataError: If a file of records cannot be read.
    """
    return comparison(read_results("laptop"), read_replicates())


def comparison(
    stored: list[dict[str, Any]], others: dict[str, list[dict[str, Any]]]
) -> str:
    """Markdown table of records beside others of the same claims; times are left out.

    A verdict is shown in a cell where it is not the one of the stored record.

    Args:
        stored: Records of the first column.
        others: Records of the further columns, by their heading.
    """
    header = ["Thesis", "Claim", "here", *others]
    lines = [header, ["---"] * len(header)]
    for record in stored:
        if record["unit"] in _MEASURES_OF_TIME:
            continue
        verdict = f": {record['verdict']}" if record["thesis_value"] is not None else ""
        row = [record["figure"], record["claim"] + verdict, ours(record)]
        for records in others.values():
            same = [item for item in records if item["id"] == record["id"]]
            row.append(_beside(record, same[0]) if same else "–")
        lines.append([cell.replace("|", "\\|") for cell in row])
    return "".join("| " + " | ".join(line) + " |\n" for line in lines)


def _beside(record: dict[str, Any], other: dict[str, Any]) -> str:
    differs = record["verdict"] != other["verdict"]
    return ours(other) + (f": **{other['verdict']}**" if differs else "")


def main(arguments: list[str] | None = None) -> int:
    """Run ``python -m cassie_lib.replication``; returns the exit code."""
    words = sys.argv[1:] if arguments is None else arguments
    if len(words) != 2 or words[0] not in ("keep", "compare"):
        print("usage: python -m cassie_lib.replication keep TITLE | compare FILE", file=sys.stderr)
        return 2
    try:
        if words[0] == "keep":
            print(f"kept {keep_replicate(words[1]).name}")
        else:
            file = Path(words[1])
            print(comparison(read_results("laptop"), {file.name: read_records(file)}), end="")
    except CassieError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


__all__ = ["comparison", "keep_replicate", "read_replicates", "replicate_file", "replicates_table"]

if __name__ == "__main__":
    sys.exit(main())
