"""The format of summary.json (docs/guide/files.md), and its values as flat tables."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypedDict, cast

from ..errors import StoreError
from .inputs import read_json_object

FORMAT = 2
_BLOCKS = ("greatest", "end", "at_end", "refused", "errors")  # tables in an impact's record
Values = dict[str, Any]


class Summary(TypedDict, total=False):
    """Contents of summary.json, SI units. run: values of the whole run; impacts: record of each impact; joins: report of the joining of
    each splat; closing: report of the closing stage; history_rows: number of rows of history.csv; provenance: `files.provenance`."""

    format: int
    version: str
    run: Values
    impacts: list[Values]
    joins: list[Values]
    closing: Values
    history_rows: int
    provenance: Values


def read_summary(path: Path) -> Summary:
    """The summary in a file. Raises StoreError if it is damaged or has another format."""
    data: Mapping[str, object] = read_json_object(path)
    form, version = data.get("format", 1), str(data.get("version", "unknown"))[:40]
    if form != FORMAT:
        remedy = "open it with that version, or compute the scene again"
        other = f"{path} has format {str(form)[:40]} (version {version})"
        raise StoreError(f"{other}, but this version reads format {FORMAT}: {remedy}")
    if (problem := problem_of(data)) is not None:
        raise StoreError(f"{path} is damaged: {problem}")
    return cast(Summary, data)


def problem_of(data: Mapping[str, object]) -> str | None:
    """Why a summary is damaged: a table or list is missing or has another type; None for a valid summary."""
    impacts = data.get("impacts")
    for name, table in (("run", data.get("run")), ("provenance", data.get("provenance", {}))):
        if not isinstance(table, dict):
            return f"{name} is not a table"
    if not isinstance(impacts, list) or not impacts:
        return "impacts is not a list of tables"
    for number, impact in enumerate(impacts, 1):
        if not isinstance(impact, dict) or not isinstance(impact.get("end"), dict):
            return f"impact {number} has no table end"
        for name in _BLOCKS:
            if impact.get(name) is not None and not isinstance(impact[name], dict):
                return f"{name} of impact {number} is not a table"
    return None


def impact_values(summary: Summary, i: int = -1) -> Values:
    """Impact i in one table: measures at its end, and all keys of its record except measures at other times."""
    impact = summary["impacts"][i]
    return impact["end"] | {key: value for key, value in impact.items() if key not in ("greatest", "end", "at_end")}


def run_values(summary: Summary) -> Values:
    """The last impact and the whole run in one table; for keys in both, the value of the run. Empty for an empty summary."""
    if not summary:
        return {}
    return impact_values(summary) | summary["run"] | {"version": summary.get("version", "unknown")}
