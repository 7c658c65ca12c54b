"""Foreign tables on which something is withheld from the simulator, filmed: the cases of `billiards_gap.py`.

Natural strengths are drawn evenly between two values, either sign where an effect has one. Where they come from:

- slope: 0.2 mm/m is allowed (WPA equipment specifications, section 3), homes have 1 to 3;
- drag: a ball in air has 0.5 rho c_d A / m = 0.005 1/m, dusty and new cloths slow fast balls by several times that;
- nap: a tenth to a third of rolling resistance; snooker players allow for as much;
- cushions: friction 0.14 (Mathavan 2010) to 0.2 (Han 2005); restitution falls from 0.98 at 1 m/s to 0.8 at 4 m/s
  (Mathavan 2010, figure 8), which is 0.06 s/m;
- ball friction 0.03 to 0.08 (Marlow 1995, table 4); a cue ball is up to 6 % heavier or lighter, and 1 to 3 % larger
  or smaller (coin-operated tables);
- other forms: e = v^-0.2 of dropped and driven balls (Stronge 2000, section 5); a lens whose r^4 is what is left of it;
- lens: r (1 + k1 r^2), 1 to 3 % at the end of the table for the cameras of phones; a length wrong by 0.5 to 2 %; a
  readout of 5 to 15 ms for a phone (Liang, Chang, Chen 2008), and one to three pictures lost.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
import pyarrow.csv
from foreign_shots import TABLE, WORLD
from numpy.typing import NDArray

from models.billiards.gap import USUAL_MODEL
from models.gap_scene import Recording

Floats = NDArray[np.float64]
Effects = dict[str, dict[str, float]]

FPS, PX_PER_M = 62.5, 350.0
"""Pictures a second: 16 samples of the world, which makes whole steps of 20 us."""
HZ, FINER = 1000, 5000
"""Samples a second: the finer ones where rows are taken at times of their own."""
SECONDS = 2.0
NOISE = 0.3 / PX_PER_M
OUTLIER = 20.0
"""standard deviations of a mistake."""
NEAR = (4.0, 6.0)
"""standard deviations of a strength just above the noise."""
TABLES = {
    "sliding_friction.mu": (0.16, 0.24), "rolling_resistance.mu": (0.007, 0.013), "spin_decay.rate": (7.0, 13.0),
    "cushion_restitution.e": (0.75, 0.9), "ball_restitution.e": (0.92, 0.97),
}  # fmt: skip
NATURAL = {
    "slope.slope_x": (1.0, 3.0), "slope.slope_y": (1.0, 3.0), "air_drag.k": (0.01, 0.04),
    "viscous_drag.k": (0.02, 0.06), "nap.mu": (0.001, 0.003), "cushion_restitution_speed.slope": (0.03, 0.08),
    "cushion_friction.mu": (0.12, 0.22), "ball_friction.mu": (0.03, 0.08), "unequal_mass.ratio": (0.03, 0.06),
    "unequal_radius.ratio": (0.01, 0.03), "lens_distortion.k1": (0.01, 0.03), "perspective.p_x": (0.005, 0.02),
    "perspective.p_y": (0.005, 0.02), "scale.seen": (0.005, 0.02), "rolling_shutter.readout": (0.005, 0.015),
    "dropped_frames.frames": (1.0, 3.0), "sticky_patch.mu": (0.005, 0.01), "curl.c": (0.1, 0.3),
    "ageing.mu": (0.0003, 0.0008),
}  # fmt: skip
"""Of ratios the difference from 1; of ageing the rolling resistance that every shot adds."""
OF_OTHER_FORM = {"cushion_restitution_power.power": (0.15, 0.25), "lens_fourth.k2": (0.01, 0.03)}
"""What no library holds, but one of its effects comes near."""
SIGNED = (
    "slope",
    "nap",
    "unequal_mass",
    "unequal_radius",
    "lens_distortion",
    "perspective",
    "scale",
    "rolling_shutter",
)
OF_BALLS = ("unequal_mass", "unequal_radius")
OF_CAMERA = ("lens_distortion", "lens_fourth", "perspective", "scale", "rolling_shutter", "dropped_frames")
IN_WORLD = ("sticky_patch", "curl")


@dataclass(frozen=True, slots=True)
class Case:
    """What the simulator lacks, and how the table is filmed."""

    name: str
    lacks: tuple[str, ...] = ()
    """effects that act and that the simulator has not; `none` is right where there are none."""
    has: tuple[str, ...] = ()
    """effects that act and that the simulator has beyond the usual ones."""
    cushion: str = "mirror"
    ball: str = "inelastic"
    """laws of the world; those of the simulator are `base` and `inelastic`."""
    base: str = "mirror"
    without: tuple[str, ...] = ()
    """effects taken out of the library: `unknown` is right, or a twin."""
    twins: tuple[str, ...] = ()
    """names that are right too: other words for the same."""
    family: str = ""
    """of the library, what comes nearest to a law of another form, and is right."""
    camera: Mapping[str, float] = field(default_factory=dict)
    """correlation, outliers, missing, fps said."""
    along: bool = False
    """every shot in one direction and at one speed: a trap."""
    shots: int = 12
    fps: float = FPS
    noise: float = 1.0
    """times NOISE."""
    harder: Literal["", "weak", "slow", "few", "noisy"] = ""
    """how it is harder than usual; weak: NEAR standard deviations, all else adjusted (billiards_gap.py)."""

    @property
    def model(self) -> tuple[str, ...]:
        """What the simulator has."""
        return tuple(name for name in (*USUAL_MODEL, *self.has) if name not in self.lacks)


SINGLE = (
    "slope", "air_drag", "viscous_drag", "nap", "cushion_restitution_speed", "cushion_friction", "ball_friction",
    "unequal_mass", "unequal_radius", "lens_distortion", "perspective", "scale", "rolling_shutter", "dropped_frames",
    "rolling_resistance", "sliding_friction", "cushion_restitution", "ball_restitution",
)  # fmt: skip
FROM_NOTHING = SINGLE[:13]
"""effects that a table or a camera need not have at all."""
_CUSHION = ("cushion_friction",)
CASES = {
    case.name: case
    for case in (
        Case("none"),
        Case("none, correlated noise", camera={"correlation": 0.6}),
        Case("none, outliers and gaps", camera={"outliers": 0.01, "missing": 0.03}),
        *(Case(name, (name,)) for name in SINGLE),
        Case("spin_decay", ("spin_decay",), _CUSHION),
        Case("cushion_law", ("cushion_law",), _CUSHION, cushion="mathavan_2010"),
        Case("ball_law", ("ball_law",), ball="alciatore", twins=("ball_friction",)),
        Case("slope and cushion_friction", ("slope", "cushion_friction")),
        Case("air_drag and lens_distortion", ("air_drag", "lens_distortion")),
        Case("nap and ball_friction", ("nap", "ball_friction")),
        Case("slope and lens_distortion", ("slope", "lens_distortion")),
        Case("rolling_resistance and cushion_restitution", ("rolling_resistance", "cushion_restitution")),
        Case("slope, not in the library", ("slope",), without=("slope",)),
        Case("cushion_friction, not in the library", ("cushion_friction",), without=("cushion_friction",)),
        Case("sticky patch", ("sticky_patch",)),
        Case("curl", ("curl",)),
        Case("ageing cloth", ("ageing",)),
        Case("slope, shots in one direction", ("slope",), along=True),
        Case("wrong frame rate", camera={"said": 60.0}),
        Case("restitution with a power of speed", ("cushion_restitution_power",), family="cushion_restitution_speed"),
        Case("lens of the fourth order", ("lens_fourth",), family="lens_distortion"),
        Case("cushion law, from another", ("cushion_law",), _CUSHION, cushion="mathavan_2010", base="han_2005"),
        *(Case(f"{name}, weak", (name,), harder="weak") for name in FROM_NOTHING),
        *(Case(f"{name}, {FPS / 2:g} pictures a second", (name,), fps=FPS / 2, harder="slow") for name in SINGLE),
        *(Case(f"{name}, 5 shots", (name,), shots=5, harder="few") for name in SINGLE),
        *(Case(f"{name}, 1 px", (name,), noise=1.0 / 0.3, harder="noisy") for name in SINGLE),
    )
}


def rng_of(case: Case, seed: int) -> np.random.Generator:
    """What all of a case is drawn from, its effects first."""
    return np.random.default_rng([1877, seed, *case.name.encode()])


def drawn(rng: np.random.Generator, case: Case) -> Effects:
    """What acts, of natural strength."""
    found: Effects = {}
    for name, span in TABLES.items():
        effect, parameter = name.split(".")
        found.setdefault(effect, {})[parameter] = float(rng.uniform(*span))
    for name, span in NATURAL.items():
        effect, parameter = name.split(".")
        value = float(rng.uniform(*span) * (rng.choice([-1, 1]) if effect in SIGNED else 1))
        if effect in (*case.lacks, *case.has) or (case.cushion != "mirror" and effect == "cushion_friction"):
            found.setdefault(effect, {})[parameter] = value
    for name, span in OF_OTHER_FORM.items():
        effect, parameter = name.split(".")
        if effect in case.lacks:
            found[effect] = {parameter: float(rng.uniform(*span))}
    if "sticky_patch" in found:
        found["sticky_patch"] |= {"x": float(rng.uniform(0.6, 1.9)), "y": float(rng.uniform(0.4, 0.9))}
    return found


def shot_of(rng: np.random.Generator, effects: Effects, case: Case, number: int) -> dict[str, object]:
    """A cue ball with any spin, played at the second ball of two to five."""
    radius, count = TABLE.ball_radius, int(rng.integers(2, 6))
    while True:
        places = rng.uniform([0.15, 0.15], [2.39, 1.12], (count, 2))
        apart = np.linalg.norm(places[:, None] - places[None], axis=-1) + np.eye(count)
        if apart.min() > 0.2 and not (case.along and places[1, 0] < places[0, 0] + 0.5):
            break
    aim = places[1] - places[0]
    angle = 0.0 if case.along else np.arctan2(aim[1], aim[0]) + rng.uniform(-1.6, 1.6) * radius / np.hypot(*aim)
    v = (1.5 if case.along else rng.uniform(1.2, 3.0)) * np.array([np.cos(angle), np.sin(angle)])
    roll, side = rng.uniform(0.0, 0.9), rng.uniform(-0.6, 0.6) * np.hypot(*v) / radius
    larger, heavier = (1 + effects.get(name, {}).get("ratio", 0.0) for name in ("unequal_radius", "unequal_mass"))
    balls: list[dict[str, object]] = [
        {"id": str(k), "x": x, "y": y, "radius": radius * (larger if k else 1), "mass": heavier if k else 1.0}
        for k, (x, y) in enumerate(places)
    ]
    balls[0] |= {"vx": v[0], "vy": v[1], "wx": -roll * v[1] / radius, "wy": roll * v[0] / radius, "wz": side}
    acting = {name: dict(values) for name, values in effects.items() if name not in (*OF_BALLS, *OF_CAMERA, "ageing")}
    if "ageing" in effects:
        acting["rolling_resistance"]["mu"] += number * effects["ageing"]["mu"]
    table = {"length": TABLE.length, "width": TABLE.width, "pockets": False}
    return {"scene": "billiards", "table": table, "seconds": SECONDS + 0.2, "hz": rate_of(effects), "balls": balls,
            "effects": acting, "laws": {"cushion": case.cushion, "ball": case.ball}}  # fmt: skip


def rate_of(effects: Effects) -> int:
    """Samples a second."""
    return FINER if "rolling_shutter" in effects else HZ


def recordings(case: Case, seed: int, strength: float = 1.0) -> tuple[tuple[Recording, ...], Effects]:
    """All shots of one table as a camera sees them, and what acted: what the simulator lacks, times `strength`."""
    rng = rng_of(case, seed)
    effects = drawn(rng, case)
    for name in case.lacks if strength != 1.0 else ():
        effects[name] = {parameter: strength * value for parameter, value in effects[name].items()}
    played = [shot_of(rng, effects, case, number) for number in range(case.shots)]
    with tempfile.TemporaryDirectory() as folder:
        told = []
        for number, shot in enumerate(played):
            (Path(folder) / f"{number}.json").write_text(json.dumps(shot))
            told += [str(Path(folder) / f"{number}.json"), str(Path(folder) / str(number))]
        subprocess.run([sys.executable, str(WORLD), *told], check=True)
        paths = [_path(Path(folder) / str(number) / "trajectory.csv") for number in range(case.shots)]
    return tuple(_filmed(rng, effects, case, number, path) for number, path in enumerate(paths)), effects


def _path(file: Path) -> Floats:
    """(T, N, 2) m, as often as the world was sampled."""
    rows = pyarrow.csv.read_csv(file)
    count = len(set(rows.column("id").to_pylist()))
    return np.stack([rows.column(name).to_numpy() for name in ("x", "y")], axis=1).reshape(-1, count, 2)


def _filmed(rng: np.random.Generator, effects: Effects, case: Case, number: int, path: Floats) -> Recording:
    frames = np.arange(round(case.fps * SECONDS))
    shown = frames.copy()
    if "dropped_frames" in effects and number % 2 == 0:
        shown[len(frames) // 3 :] += round(effects["dropped_frames"]["frames"])
    xy = _seen(effects, path, shown / case.fps)
    noise = rng.normal(size=xy.shape)
    correlation = case.camera.get("correlation", 0.0)
    for k in range(1, len(noise)):
        noise[k] = correlation * noise[k - 1] + np.sqrt(1 - correlation**2) * noise[k]
    wrong = rng.random(xy.shape[:2]) < case.camera.get("outliers", 0.0)
    noise[wrong] += OUTLIER * rng.normal(size=(int(wrong.sum()), 2))
    sigma = case.noise * NOISE
    xy = xy + sigma * noise
    lost = rng.random(xy.shape[:2]) < case.camera.get("missing", 0.0)
    lost[0] = False
    xy[lost] = np.nan
    t = frames / case.camera.get("said", case.fps)
    return Recording(number, frames, t, tuple(str(k) for k in range(xy.shape[1])), xy, np.full(xy.shape[:2], sigma))


def _seen(effects: Effects, path: Floats, t: Floats) -> Floats:
    """(T, N, 2) m, as a camera shows places at times t: rows later, then scale, lens and perspective."""
    rate = rate_of(effects)
    xy = path[np.clip(np.round(t * rate), 0, len(path) - 1).astype(int)]
    middle, half = np.array([TABLE.length, TABLE.width]) / 2, TABLE.length / 2
    if "rolling_shutter" in effects:
        late = effects["rolling_shutter"]["readout"] * (xy[..., 1] - middle[1]) / TABLE.width
        rows = np.clip(np.round((t[:, None] + late) * rate), 0, len(path) - 1).astype(int)
        xy = path[rows, np.arange(path.shape[1])]
    away = (xy - middle) / half
    away = away * (1 + effects.get("scale", {}).get("seen", 0.0))
    away = away * (1 + effects.get("lens_distortion", {}).get("k1", 0.0) * (away**2).sum(axis=-1, keepdims=True))
    away = away * (1 + effects.get("lens_fourth", {}).get("k2", 0.0) * (away**2).sum(axis=-1, keepdims=True) ** 2)
    tilt = effects.get("perspective", {})
    away = away / (1 + tilt.get("p_x", 0.0) * away[..., :1] + tilt.get("p_y", 0.0) * away[..., 1:])
    return np.asarray(middle + half * away)
