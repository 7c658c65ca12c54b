"""One method on one series, kept in the cache: what was once worked out is not worked out again."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from models.core.typing import FloatArray
from models.neural.common.method_interface import Budget, Fitted, Method
from models.neural.common.spline_methods import CUBIC, LINEAR
from pipeline.engine.result_cache import Cache, Key
from pipeline.engine.source_fingerprint import library_versions, source_hashes
from pipeline.experiments.thesis.assessed_motion import Judged
from pipeline.experiments.thesis.scenes.withheld_series import Case, Series, mean_square

STAGE = "reproduce"
LOST = 1e6
"""px: a motion that is farther off at any midpoint is lost, and its error is that."""


@dataclass(frozen=True, slots=True)
class Trial:
    """How one method did on one series of H withheld midpoints."""

    case: Case
    method: str
    mse: float
    """px^2 over the withheld midpoints: mean over points and coordinates."""
    x_linear: float
    """How many times lower than that of the polygon through the visible samples."""
    x_cubic: float
    """... than that of the cubic spline through them."""
    seconds: float
    """CPU s of learning."""
    parameters: int
    """Numbers that were learnt."""
    note: str
    """What is wrong with the motion; empty where nothing is known to be."""
    t: FloatArray
    """(H,) s of the midpoints."""
    error: FloatArray
    """(H,) px: root mean square over points and coordinates at each."""
    loss: FloatArray
    """(L,) of the network on what it saw."""

    @property
    def row(self) -> dict[str, Any]:
        """As in the contract: numbers that are not finite are None."""
        numbers = {name: getattr(self, name) for name in ("mse", "x_linear", "x_cubic", "seconds")}
        finite = {name: value if np.isfinite(value) else None for name, value in numbers.items()}
        case = self.case
        return {"scene": case.scene, "variant": case.variant, "method": self.method, "fps": case.fps,
                "noise_px": case.noise, "seed": case.seed, **finite, "parameters": self.parameters,
                "note": self.note}  # fmt: skip


def tried(method: Method, series: Series, budget: Budget, cache: Cache) -> Trial:
    """The trial, from the cache where the same was tried with the same code."""
    key = Key(STAGE, _parts(method, series, budget))
    return _read(series.case, method.name, cache.make(key, lambda folder: _try(method, series, budget, folder)).folder)


def is_known(method: Method, series: Series, budget: Budget, cache: Cache) -> bool:
    """Whether the cache has the trial."""
    return cache.find(Key(STAGE, _parts(method, series, budget))) is not None


def _parts(method: Method, series: Series, budget: Budget) -> dict[str, Any]:
    return {
        "case": asdict(series.case), "content": _content(series), "method": [type(method).__qualname__, method.name],
        "budget": [budget.effort, budget.seconds], "source": _sources(type(method).__module__),
        "libraries": library_versions(),
    }  # fmt: skip


@lru_cache(maxsize=64)
def _sources(module: str) -> dict[str, str]:
    return {**source_hashes(module), **source_hashes(__name__)}


def _content(series: Series) -> str:
    """Digest of the numbers of a series."""
    digest = hashlib.sha256()
    for part in (series.t, series.seen, series.truth):
        digest.update(np.ascontiguousarray(part).tobytes())
    return digest.hexdigest()


def _try(method: Method, series: Series, budget: Budget, folder: Path) -> None:
    t, truth = series.hidden
    fitted, note = _learnt(lambda: method.fit(*series.shown, series.case.seed, budget))
    guess = np.full_like(truth, np.nan) if fitted is None else fitted.at(t)
    off = np.nan_to_num(guess - truth, nan=LOST, posinf=LOST, neginf=-LOST).clip(-LOST, LOST)
    error = np.sqrt(np.mean(off**2, axis=(1, 2)))
    loss = np.empty(0) if fitted is None else fitted.loss_curve
    np.savez(folder / "trial.npz", t=t, error=error, loss=loss)
    mse = float(np.mean(off**2))
    rivals = {name: mean_square(curve.fit(*series.shown, 0, budget).at(t), truth) / mse if mse > 0 else np.inf
              for name, curve in (("x_linear", LINEAR), ("x_cubic", CUBIC))}  # fmt: skip
    told = {"mse": mse, **rivals, "seconds": fitted.seconds if fitted else np.nan,
            "parameters": fitted.parameters if fitted else 0, "note": note or _lost(guess, fitted)}  # fmt: skip
    (folder / "trial.json").write_text(json.dumps(told), encoding="utf-8")


def _learnt(fit: Callable[[], Fitted]) -> tuple[Fitted | None, str]:
    """The motion, or the sentence with which a method refused the series."""
    try:
        return fit(), ""
    except ValueError as error:
        return None, str(error)


def _lost(guess: FloatArray, fitted: Fitted | None) -> str:
    if not np.isfinite(guess).all():
        return "the motion is lost"
    return "; ".join(fitted.doubts) if isinstance(fitted, Judged) else ""


def _read(case: Case, name: str, folder: Path) -> Trial:
    told = json.loads((folder / "trial.json").read_text(encoding="utf-8"))
    with np.load(folder / "trial.npz") as arrays:
        return Trial(case, name, **told, **{key: arrays[key] for key in ("t", "error", "loss")})
