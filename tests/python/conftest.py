"""How Hypothesis runs here: no clock decides, and on CI the same examples every time; and where the C library is."""

import os
import platform
import shutil
import subprocess
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

settings.register_profile(
    "linkside",
    deadline=None,
    derandomize="CI" in os.environ,
    # Random robots are often beside the point of a test; that is no fault of theirs, nor is a slow machine.
    suppress_health_check=[HealthCheck.filter_too_much, HealthCheck.too_slow, HealthCheck.data_too_large],
)
settings.load_profile("linkside")

ROOT = Path(__file__).parents[2]
LIBRARIES = (os.environ.get("LINKSIDE_CAPI", ""), ROOT / "target/release/deps", ROOT / "target/release")
"""Where `cargo test --release` leaves the C library; the first one must have it where it is given."""


@pytest.fixture(scope="session")
def library():
    """The folder of the C library."""
    name = "liblinkside.dylib" if platform.system() == "Darwin" else "liblinkside.so"
    for folder in filter(None, LIBRARIES):
        if (Path(folder) / name).is_file():
            return Path(folder).resolve()
    if LIBRARIES[0]:
        pytest.fail(f"LINKSIDE_CAPI={LIBRARIES[0]} has no {name}")
    pytest.skip(f"no {name}: cargo test --release -p linkside-capi builds it")


@pytest.fixture(scope="session")
def build(library, tmp_path_factory):
    """Compile a C++ program with the library."""
    compiler = shutil.which("c++") or pytest.skip("no C++ compiler")
    folder = tmp_path_factory.mktemp("cpp")

    def build(*sources, include=()):
        program = folder / sources[0].stem
        flags = ["-std=c++17", "-O1", "-Wall", "-Wextra", "-Werror"]
        flags += [f"-I{ROOT / path}" for path in ("rust/capi/include", *include)]
        link = [f"-L{library}", "-llinkside", f"-Wl,-rpath,{library}"]
        subprocess.run([compiler, *flags, *sources, "-o", program, *link], check=True)
        return program

    return build
