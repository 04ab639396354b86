"""The file plan.json of a run: the plan as JSON. Numbers that JSON does not have are written as texts, such as "Infinity"."""

import hashlib
import json
from functools import cache
from pathlib import Path

from pydantic import TypeAdapter, ValidationError
from pydantic_core import to_json

from .. import __version__
from ..errors import StoreError
from ..files.inputs import read_json_object
from .model import Plan

FILE = "plan.json"
FORMAT = 11


def plan_text(plan: Plan) -> str:
    """The plan as the text of plan.json."""
    data = json.loads(to_json(plan, inf_nan_mode="strings"))
    whole = {"format": FORMAT, "version": __version__, "sha256": _checksum(data), "plan": data}
    return json.dumps(whole, indent=1) + "\n"


def read_plan(folder: Path) -> Plan:
    """The plan of a run, from its folder. Raises StoreError if it is missing, damaged, or of another format."""
    path = folder / FILE
    if not path.exists():
        raise StoreError(
            f"{folder} has no {FILE}, perhaps because it is a run of version 0.1: compute the scene again with this version"
        )
    data = read_json_object(path)
    plan, problem = data.get("plan"), ""
    if data.get("format") != FORMAT:
        problem = f"is not a plan of format {FORMAT}"
    elif data.get("sha256") != _checksum(plan):
        problem = "is damaged: its checksum does not fit"
    else:
        try:
            return _plans().validate_python(plan)
        except ValidationError as error:
            first = error.errors()[0]
            problem = f"is damaged: {'.'.join(map(str, first['loc']))}: {first['msg']}"
    raise StoreError(f"{path} {problem}: this version cannot continue the run; compute the scene again")


@cache
def _plans() -> TypeAdapter[Plan]:
    """The reader of plans, made once: the table of a sweep reads as many plans as it has points."""
    return TypeAdapter(Plan)


def _checksum(data: object) -> str:
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()
