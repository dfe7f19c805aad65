# SPDX-License-Identifier: BSD-3-Clause
"""The compiled part of the Python package, built by CMake. Everything else is in pyproject.toml."""
import os
import pathlib
import shutil
import subprocess
import sys

from setuptools import Extension, setup
from setuptools.command.build_ext import build_ext

ROOT = pathlib.Path(__file__).resolve().parent


class CMakeBuild(build_ext):
    """Configures a release build for this interpreter, builds the module, and puts it into the package.
    LOOPWISE_CMAKE_ARGS adds arguments for CMake."""

    def build_extension(self, ext):
        folder = pathlib.Path(self.build_temp).resolve() / "cmake"
        folder.mkdir(parents=True, exist_ok=True)
        generator = ["-G", "Ninja"] if shutil.which("ninja") else []
        options = {"CMAKE_BUILD_TYPE": "Release", "CMAKE_POSITION_INDEPENDENT_CODE": "ON",
                   "LOOPWISE_WITH_PYTHON": "ON", "LOOPWISE_BUILD_APPS": "OFF", "LOOPWISE_BUILD_TESTS": "OFF",
                   "LOOPWISE_WITH_REPORT": "OFF", "LOOPWISE_UNITY_BUILD": "ON", "Python_EXECUTABLE": sys.executable}
        subprocess.run(["cmake", "-S", str(ROOT), "-B", str(folder), *generator,
                        *(f"-D{name}={value}" for name, value in options.items()),
                        *os.environ.get("LOOPWISE_CMAKE_ARGS", "").split()], check=True)
        subprocess.run(["cmake", "--build", str(folder), "--parallel", str(os.cpu_count() or 1),
                        "--target", "loopwise_python"], check=True)
        built = list((folder / "python" / "loopwise").glob("_loopwise*.so"))
        if len(built) != 1:
            raise RuntimeError(f"CMake made {len(built)} modules in {folder}/python/loopwise, expected one")
        target = pathlib.Path(self.get_ext_fullpath(ext.name))
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(built[0], target)


setup(ext_modules=[Extension("loopwise._loopwise", sources=[])], cmdclass={"build_ext": CMakeBuild})
