"""PyMC and ArviZ are imported where the home cannot be written."""

import os
import subprocess
import sys


def test_libraries_are_imported_without_a_home_and_without_a_word(tmp_path):
    (tmp_path / "rc").write_text("[global]\nbase_compiledir = /proc/nothing\n")
    strange = {
        **dict.fromkeys(("HOME", "XDG_CACHE_HOME", "MPLCONFIGDIR"), "/proc/nothing"),
        "PYTENSOR_FLAGS": "nonsense=1,base_compiledir=/proc/nothing",
        "PYTENSORRC": str(tmp_path / "rc"),
    }
    code = (
        "import os; import fast.models; before = dict(os.environ);"
        "from fast.models.calibration.inference.libraries import quiet_import\n"
        "with quiet_import():\n    import pymc\n"
        "print(pymc.__name__, [name for name in before if os.environ[name] != before[name]])"
    )
    done = subprocess.run([sys.executable, "-c", code], env=os.environ | strange, capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("pymc []\n", "")
