"""What `import cosim` gives, and what it costs."""

import subprocess
import sys

import cosim
import gri


def test_every_public_name_is_there():
    assert all(getattr(cosim, name) is not None for name in cosim.__all__)
    assert dir(cosim) == sorted([*cosim.__all__, "__version__"])


def test_both_packages_have_the_version_of_the_project():
    assert cosim.__version__ == gri.__version__


def test_the_import_alone_is_light():
    code = "import sys, cosim, gri; print(sorted({'torch', 'pandas', 'libsumo', 'matplotlib'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
