"""What LAMMPS needs of the process that it runs in."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from coupler.errors import ColdsprayError
from coupler.particle.start import whole_process

HALF = """
import locale
from coupler.particle.start import lammps, whole_process
locale.setlocale(locale.LC_ALL, "de_DE.UTF-8")
with whole_process():
    lmp = lammps(cmdargs=["-screen", "none", "-log", "none"])
    lmp.command("variable half equal 0.5")
    assert lmp.extract_variable("half") == 0.5
    lmp.close()
assert locale.localeconv()["decimal_point"] == ","
"""


def test_a_process_computes_one_run_at_a_time() -> None:
    """A second one, in another thread, would share its standard output: refused, and possible once the first is over."""
    with whole_process(), pytest.raises(ColdsprayError, match="in its own process"), whole_process():
        pass
    with whole_process():
        pass


@pytest.mark.skipif(shutil.which("localedef") is None, reason="no localedef")
def test_numbers_have_a_point_in_a_locale_with_a_comma(tmp_path: Path) -> None:
    """As toolkits of windows set it; LAMMPS refuses to begin there. The program's own locale is back afterwards."""
    subprocess.run(
        ["localedef", "-i", "de_DE", "-f", "UTF-8", tmp_path / "de_DE.UTF-8"], check=True, capture_output=True
    )
    environment = os.environ | {"LOCPATH": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", HALF], env=environment, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")
