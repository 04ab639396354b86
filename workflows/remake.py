"""Remake a page of docs/evidence: run the commands under its heading "How to remake it", one after the other.

python workflows/remake.py PAGE           # such as bonding; hours for some pages, rows of tables that exist are not computed again
python workflows/remake.py PAGE --print   # only print the commands
"""

import argparse
import os
import re
import subprocess
import sys
from pathlib import Path

from pages import EVIDENCE

COMMAND = re.compile(r"`((?:python|coldspray|make) [^`]+)`")


def commands(page: Path) -> list[str]:
    """The commands of a page, in their order. Raises SystemExit without any."""
    text = page.read_text(encoding="utf-8") if page.exists() else ""
    section = text.partition("## How to remake it")[2].partition("\n## ")[0]
    found = [" ".join(command.split()) for command in COMMAND.findall(section)]
    if not found:
        raise SystemExit(
            f"{page} has no commands: give one of {', '.join(sorted(p.stem for p in EVIDENCE.glob('*.md')))}"
        )
    return found


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("page")
    parser.add_argument("--print", action="store_true")
    arguments = parser.parse_args()
    found = commands(EVIDENCE / f"{arguments.page}.md")
    os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    for command in found:
        print(command, flush=True)
        if not arguments.print and (code := subprocess.run(command, shell=True, check=False).returncode):
            raise SystemExit(f"{command}: exit code {code}")
