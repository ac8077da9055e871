"""Vectors are made of numba's internals: a version that has others is named, with what to do."""

import subprocess
import sys

OTHER_NUMBA = "import numba.core.typing.templates as internals; del internals.infer_global; import polyida.element.lanes"


def test_another_numba_is_named():
    found = subprocess.run([sys.executable, "-c", OTHER_NUMBA], capture_output=True, text=True, check=False)
    assert found.returncode and "others in numba" in found.stderr and "infer_global" in found.stderr
