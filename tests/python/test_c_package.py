"""The C library as it is installed: a program finds it by pkg-config and by CMake."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

PROGRAM = """
#include <linkside.hpp>
#include <cstdio>

int main() {
    try {
        linkside::Estimator estimator("missing.lsr");
    } catch (const linkside::Error& error) {
        std::printf("%d %s\\n", linkside_version(), error.what());
    }
}
"""

LISTS = """
cmake_minimum_required(VERSION 3.16)
project(program CXX)
find_package(linkside {version} REQUIRED)
foreach(kind linkside static)
  add_executable(program-${{kind}} program.cpp)
  target_link_libraries(program-${{kind}} PRIVATE linkside::${{kind}})
  target_compile_features(program-${{kind}} PRIVATE cxx_std_17)
endforeach()
"""


@pytest.fixture(scope="module")
def prefix(library, tmp_path_factory):
    where = tmp_path_factory.mktemp("first")
    subprocess.run([ROOT / "rust/capi/install/install.sh", library, where], check=True)
    return where.rename(where.parent / "moved")  # the packages know no folder of the machine that made them


def source(folder):
    (folder / "program.cpp").write_text(PROGRAM)
    return folder / "program.cpp"


def assert_works(program, folder):
    done = subprocess.run([program], cwd=folder, check=True, capture_output=True, text=True)
    assert done.stdout.startswith("1000 missing.lsr: ")


def tool(name):
    return shutil.which(name) or pytest.skip(f"no {name}")


def flags(prefix, *options):
    found = os.environ | {"PKG_CONFIG_PATH": str(prefix / "lib/pkgconfig")}
    command = [tool("pkg-config"), *options, "linkside"]
    return subprocess.run(command, env=found, check=True, capture_output=True, text=True).stdout.split()


def test_pkg_config(prefix, tmp_path):
    linked = [*flags(prefix, "--cflags", "--libs"), f"-Wl,-rpath,{prefix / 'lib'}"]
    program = tmp_path / "program"
    subprocess.run([tool("c++"), "-std=c++17", source(tmp_path), "-o", program, *linked], check=True)
    assert_works(program, tmp_path)
    assert flags(prefix, "--modversion") == ["0.1.0"]


def test_cmake(prefix, tmp_path):
    source(tmp_path)
    (tmp_path / "CMakeLists.txt").write_text(LISTS.format(version="0.1"))
    configure = [tool("cmake"), "-S", tmp_path, "-B", tmp_path / "build", f"-DCMAKE_PREFIX_PATH={prefix}"]
    subprocess.run(configure, check=True, capture_output=True)
    subprocess.run(["cmake", "--build", tmp_path / "build"], check=True, capture_output=True)
    for kind in ("linkside", "static"):
        assert_works(tmp_path / f"build/program-{kind}", tmp_path)
    (tmp_path / "CMakeLists.txt").write_text(LISTS.format(version="0.2"))
    refused = subprocess.run([*configure, "--fresh"], check=False, capture_output=True, text=True)
    assert refused.returncode != 0
    assert "version: 0.1.0" in refused.stderr


def test_a_folder_without_the_library_is_refused(tmp_path):
    command = [ROOT / "rust/capi/install/install.sh", tmp_path, tmp_path / "prefix"]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.returncode == 1
    assert "cargo build --release -p linkside-capi" in done.stderr
    assert not Path(tmp_path / "prefix").exists()
