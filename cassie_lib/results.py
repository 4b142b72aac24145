"""``figures/results.json``: one record per claim, and the tables of the README made from it."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from cassie_lib import paths
from cassie_lib.code_version import git_commit, lock_hash
from cassie_lib.errors import DataError, NonFiniteError, ParameterError, unknown_name
from cassie_lib.files import locked, write_json
from cassie_lib.presets import get_preset
from cassie_lib.provenance import changed_parameters

VERDICTS = ("reproduced", "better", "not reproduced", "not comparable")
#: File to which :func:`record_result` adds the ids that it writes.
MADE = "CASSIE_CLAIM_LOG"
#: What the tables read of a record.
_SHOWN = frozenset(
    "id claim figure value interval unit seeds thesis_value verdict reason wall_time_s".split()
)
_CLAIM = re.compile(r"\d\d-[a-z0-9]+(-[a-z0-9]+)*")
_COLUMNS = ("Thesis", "Claim", "Notebook", "Command", "Minutes here (cached / from nothing)")
_COMPARED = (*_COLUMNS, "Thesis's number", "Ours [95 % interval]", "Verdict")
#: Of what the thesis has no number for.
_OWN = (*_COLUMNS, "Ours [95 % interval]", "Remark")


class Result(dict[str, Any]):
    """Record of a claim; shown in a notebook as one line."""

    def __repr__(self) -> str:
        """Ours, the thesis's and the verdict."""
        thesis = _number(self["thesis_value"], self["unit"])
        return f"{self['id']}: {ours(self)}; thesis ({self['figure']}) {thesis}: {self['verdict']}"


def results_file(preset: str) -> Path:
    """Where the records of a preset are: in git for an unchanged ``laptop`` run only."""
    return paths.figures_folder(preset, bool(changed_parameters())) / "results.json"


def read_results(preset: str = "laptop") -> list[dict[str, Any]]:
    """Records of a preset, sorted by claim; empty when there are none yet.

    Raises:
        DataError: If the file cannot be read.
    """
    file = results_file(preset)
    return read_records(file) if file.exists() else []


def read_records(file: Path) -> list[dict[str, Any]]:
    """Records of any ``results.json``, sorted by claim.

    Raises:
        DataError: If the file cannot be read.
    """
    try:
        records = json.loads(file.read_text(encoding="utf-8"))
        lacking = sorted({name for record in records for name in _SHOWN - record.keys()})
        if not lacking:
            return sorted(records, key=lambda record: record["id"])
    except (OSError, ValueError, TypeError, AttributeError):
        raise DataError(f"{file.name} cannot be read: expected a JSON list of records") from None
    raise DataError(f"{file.name} lacks {', '.join(lacking)}: expected them in every record")


def record_result(
    claim_id: str,
    figure: str,
    preset: str,
    value: float | None,
    interval: tuple[float, float] | None,
    seeds: int,
    protocol: str,
    wall_time_s: float,
    thesis_value: float | str | None,
    verdict: str,
    *,
    claim: str = "",
    unit: str = "",
    reason: str = "",
) -> Result:
    """Write the record of one claim, replacing an older one of the same id.

    Args:
        claim_id: Number of the notebook and a name, e.g. ``"06-reward-per-step"``.
        figure: Thesis figure or table, e.g. ``"Figure 5.6"``.
        preset: Name of the preset that really ran.
        value: Our number in ``unit``; None when there is none.
        interval: Its 95 % interval, low and high.
        seeds: Number of seeds behind it.
        protocol: How it was measured, one line.
        wall_time_s: Seconds that it takes from nothing.
        thesis_value: The thesis's number, or text.
        verdict: One of :data:`VERDICTS`.
        claim: What is claimed, in a few words.
        unit: Unit of all values.
        reason: Why this verdict, a few words for the table.

    Raises:
        ParameterError: If the id has another form or the interval is not low and high.
        NonFiniteError: If a number is not finite.
        UnknownNameError: If the verdict or the preset is unknown.
    """
    if not _CLAIM.fullmatch(claim_id):
        raise ParameterError(f"claim id is {claim_id!r}: expected a form like '06-reward'")
    if verdict not in VERDICTS:
        raise unknown_name("verdict", verdict, VERDICTS)
    get_preset(preset)
    numbers = [value, *(interval or ()), wall_time_s]
    if any(n is not None and not abs(float(n)) < float("inf") for n in numbers):
        raise NonFiniteError(f"result {claim_id} holds {numbers}: expected finite numbers")
    if interval is not None and (len(interval) != 2 or interval[0] > interval[1]):
        raise ParameterError(f"interval of {claim_id} is {interval}: expected (low, high)")
    record = Result(
        id=claim_id,
        claim=claim,
        figure=figure,
        preset=preset,
        value=value,
        interval=interval,
        unit=unit,
        seeds=seeds,
        protocol=protocol,
        wall_time_s=round(float(wall_time_s), 1),
        thesis_value=thesis_value,
        verdict=verdict,
        reason=reason,
        commit=git_commit(),
        lock=lock_hash(),
    )
    with locked(paths.CACHE / "locks" / f"results-{preset}.lock", "it writes results.json"):
        others = [item for item in read_results(preset) if item["id"] != claim_id]
        write_json(results_file(preset), sorted([*others, record], key=lambda item: item["id"]))
    if os.environ.get(MADE):
        with open(os.environ[MADE], "a", encoding="utf-8") as file:
            file.write(f"{claim_id}\n")
    return record


def forget_other_claims(preset: str, number: str, made: Path) -> None:
    """Forget the records of a notebook that it has not written in the run that has just passed.

    Otherwise a claim that a notebook no longer makes would stay in the table for ever.

    Args:
        preset: Name of the preset.
        number: Of the notebook, two digits.
        made: File that :data:`MADE` named during the run.
    """
    ids = set(made.read_text(encoding="utf-8").split()) if made.exists() else set()
    with locked(paths.CACHE / "locks" / f"results-{preset}.lock", "it writes results.json"):
        records = read_results(preset)
        kept = [item for item in records if item["id"] in ids or item["id"][:2] != number]
        if len(kept) < len(records):
            write_json(results_file(preset), kept)


def _notebook(number: str) -> str:
    found = sorted(paths.NOTEBOOKS.glob(f"{number}_*.ipynb"))
    if not found:
        return number
    # GitHub shows the executed copy with its pictures.
    executed = paths.FIGURES / "executed" / found[0].name
    shown = executed if executed.exists() else found[0]
    return f"[{number}]({shown.relative_to(paths.ROOT).as_posix()})"


def _cached_minutes(number: str) -> str:
    for file in sorted((paths.FIGURES / "executed").glob(f"{number}_*.ipynb")):
        book = json.loads(file.read_text(encoding="utf-8"))
        duration = book["metadata"].get("papermill", {}).get("duration")
        if duration:
            return f"{duration / 60:.1f}"
    return "–"


def _digits(value: float) -> str:
    # Three figures, but never 1e+03 for a count of steps.
    return f"{value:.0f}" if 1000 <= abs(value) < 1e7 else f"{value:.3g}"


def _number(value: Any, unit: str = "") -> str:
    if value is None:
        return "–"
    text = value if isinstance(value, str) else _digits(value)
    return f"{text} {unit}" if unit and not isinstance(value, str) else text


def ours(record: dict[str, Any]) -> str:
    """Value, unit, interval and number of seeds of a record, as the README's tables show them."""
    text = _number(record["value"], record["unit"])
    if record["interval"]:
        low, high = record["interval"]
        text += f" [{_digits(low)}, {_digits(high)}]"
    if record["seeds"] > 1:
        text += f", {record['seeds']} seeds"
    return text


def claim_of(record: dict[str, Any]) -> str:
    """What a record claims, in words."""
    return str(record["claim"] or record["id"][3:].replace("-", " "))


def _row(record: dict[str, Any]) -> list[str]:
    number, reason = record["id"][:2], record["reason"]
    if record["thesis_value"] is None:
        last = [ours(record), reason]
    else:
        verdict = f"**{record['verdict']}**" + (f": {reason}" if reason else "")
        last = [_number(record["thesis_value"], record["unit"]), ours(record), verdict]
    return [
        record["figure"],
        claim_of(record),
        _notebook(number),
        f"`make figures ONLY={number}`",
        f"{_cached_minutes(number)} / {record['wall_time_s'] / 60:.1f}",
        *last,
    ]


def results_table() -> str:
    """Markdown tables of the ``laptop`` records: beside the thesis's numbers, then our own.

    Raises:
        DataError: If ``figures/results.json`` cannot be read.
    """
    records = read_results("laptop")
    if not records:
        return "No results yet: `make figures` writes them.\n"
    parts: dict[tuple[str, ...], list[list[str]]] = {_COMPARED: [], _OWN: []}
    for record in records:
        parts[_OWN if record["thesis_value"] is None else _COMPARED].append(_row(record))
    tables = [markdown_table(columns, rows) for columns, rows in parts.items() if rows]
    return "\nWhat the thesis gives no number for:\n\n".join(tables)


def markdown_table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table; bars inside its cells are escaped."""
    lines = [[cell.replace("|", "\\|") for cell in line] for line in (columns, *rows)]
    header, *body = ("| " + " | ".join(line) + " |\n" for line in lines)
    return header + "|---" * len(columns) + "|\n" + "".join(body)
