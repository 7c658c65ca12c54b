"""Run rivals from the package registry in environments of their own, so that their packages never meet the project's.

An environment holds the named packages with what they need, and lies in the cache folder of the user; it is made once,
as that of the project. A function of a rival module runs there as a process: arrays go in and come out as npz files.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.support.figures import ROOT, MissingInputError

CACHE = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "trueroll-rivals"
CALL = """
import importlib, sys, numpy
module, name, inputs, outputs = sys.argv[1:]
results = getattr(importlib.import_module(module), name)(**numpy.load(inputs))
numpy.savez(outputs, **results)
"""


@dataclass(frozen=True)
class RivalEnvironment:
    """An environment with some packages."""

    name: str
    packages: tuple[str, ...]

    @property
    def folder(self) -> Path:
        """The folder, which changes with the packages and the Python version."""
        text = "\n".join([*self.packages, sys.version])
        return CACHE / f"{self.name}-{hashlib.sha256(text.encode()).hexdigest()[:12]}"

    def prepare(self) -> Path:
        """Return the interpreter of the environment, which is made first where it is missing.

        Raises:
            MissingInputError: The packages cannot be installed on this machine.
        """
        python, stamp = self.folder / "bin" / "python", self.folder / "complete"
        CACHE.mkdir(parents=True, exist_ok=True)
        with self.folder.with_suffix(".lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)  # two benchmarks may need it at once
            if not stamp.is_file():
                self._install(python)
                stamp.touch()
        return python

    def call(
        self, function: Callable[..., dict[str, np.ndarray]], arrays: Mapping[str, np.ndarray]
    ) -> dict[str, np.ndarray]:
        """Call a function of an importable module in the environment; its packages are imported inside the function.

        Raises:
            MissingInputError: The packages cannot be installed on this machine.
            RuntimeError: The function failed.
        """
        python = self.prepare()
        environment = os.environ | {"PYTHONPATH": str(ROOT)}
        with tempfile.TemporaryDirectory() as folder:
            inputs, outputs = Path(folder) / "inputs.npz", Path(folder) / "outputs.npz"
            np.savez(inputs, **arrays)
            command = [str(python), "-c", CALL, function.__module__, function.__name__, str(inputs), str(outputs)]
            done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
            if done.returncode:
                raise RuntimeError(f"{self.name} failed: {done.stderr.strip()[-2000:]}")
            with np.load(outputs) as results:
                return dict(results)

    def _install(self, python: Path) -> None:
        shutil.rmtree(self.folder, ignore_errors=True)
        for command in (
            [sys.executable, "-m", "venv", str(self.folder)],
            [str(python), str(ROOT / ".ci" / "install.py"), *self.packages],
        ):
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:
                raise MissingInputError(f"the environment of {self.name} cannot be made: {_last_line(done)}")


def _last_line(done: subprocess.CompletedProcess[str]) -> str:
    return ((done.stderr.strip() or done.stdout.strip()).splitlines() or [f"status {done.returncode}"])[-1].strip()
