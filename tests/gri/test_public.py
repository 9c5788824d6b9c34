"""What `import gri` gives, and what it costs."""

import subprocess
import sys

import gri


def test_every_public_name_is_there():
    assert all(getattr(gri, name) is not None for name in gri.__all__)
    assert dir(gri) == sorted([*gri.__all__, "__version__"])


def test_reading_a_scenario_does_not_import_torch():
    code = "import sys; from cosim.spec.loading import load_scenario; load_scenario('us101_car_following')"
    code += "; print('torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
