"""Billiards under diagnosis: whole shots, all effects of the catalogue, published laws of the cushion and of balls."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from models.core.scene import Table
from models.core.tracks import Tracks
from models.core.typing import BoolArray, FloatArray
from models.estimation.gap_scenes.gap_scene import Alternatives, Covariates, Recording
from models.estimation.gap_scenes.time_jumps import time_jumps
from models.estimation.whole_shot.initial_states import beginning, strikes
from models.estimation.whole_shot.shot_segments import Stretch
from models.estimation.whole_shot.shot_windows import Shots
from models.physics.billiards.calibration_errors import View
from models.physics.billiards.simulation.event_engine import BALL, FIRST, HOLE, KIND, SECOND, TIME
from models.physics.billiards.simulation.parametrised_shot import Laws, slips
from models.physics.billiards.simulation.simulated_shot import Run
from models.physics.effect import Effect, Prior
from models.physics.effects.catalogue import BILLIARDS, BILLIARDS_LAWS

USUAL_MODEL = (
    "rolling_resistance", "sliding_friction", "spin_decay", "cushion_restitution", "ball_restitution",
)  # fmt: skip
"""What a simulator has of whom nothing is said."""
_CONTACT = 0.25
"""s for which what is seen is put down to a contact, even where the ball rolls again."""
_SLIPS = 0.01
"""m/s of slip from which a ball slides."""
_RESTS = 1e-3
"""m/s below which a ball rests."""


@dataclass(frozen=True, slots=True)
class Picture:
    """How a table is filmed."""

    middle: FloatArray
    """(2,) m, of the picture."""
    height: float
    """m that its rows cover."""
    px_per_m: float


@dataclass(frozen=True, slots=True)
class BilliardsScene:
    """See `models.estimation.gap_scenes.gap_scene.GapScene`."""

    table: Table
    picture: Picture
    assumed: tuple[str, ...] = USUAL_MODEL
    laws: Laws = field(default_factory=Laws)
    """which the simulator has."""
    jumps: tuple[tuple[int, float, float], ...] = ()
    """Shot, time (s) from which on pictures seem to be missing, and time between two pictures (s)."""
    effects: tuple[Effect, ...] = BILLIARDS
    name: str = "billiards"
    unit: str = "m"
    gauges: tuple[str, ...] = ("frame_rate", "time_offset", "parallax_shift")
    not_tested: tuple[str, ...] = ()
    _made: dict[tuple[int, bool], tuple[Recording, Stretch]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )
    """Stretches by the number of their piece, which is kept so that no other one takes it."""
    calm: float = 0.5
    """s, see `models.estimation.gap_scenes.gap_scene.Eventful`: in half a second a ball seldom touches more than one thing."""

    @property
    def alternatives(self) -> tuple[Alternatives, ...]:
        """Of cushions and of balls; without loss and friction, `elastic` is `inelastic`."""
        cushion, ball = BILLIARDS_LAWS
        of_balls = tuple(form for form in ball.forms if form != "elastic" or self.laws.ball == "elastic")
        return (
            Alternatives(cushion.name, cushion.forms, self.laws.cushion, cushion.phases, cushion.brings),
            Alternatives(ball.name, of_balls, self.laws.ball, ball.phases, ball.brings),
        )

    def stretches(self, recording: Recording) -> tuple[Recording, ...]:
        """From every strike to the next one."""
        return tuple(recording.rows(*rows) for rows in strikes(recording.places, recording.sigma))

    def model(self, pieces: tuple[Recording, ...], forms: tuple[str, ...], wanted: BoolArray | None = None) -> Shots:
        """Whole pieces; spin is carried over where one follows the other directly."""
        follows = [False, *(_follow_directly(one, other) for one, other in pairwise(pieces))]
        stretches = tuple(self._stretch(piece, after) for piece, after in zip(pieces, follows, strict=True))
        return Shots(stretches, self.table, self._priors(), Laws(*forms), view=self._view, wanted=wanted)

    def covariates(self, piece: Recording, start: FloatArray, shared: FloatArray, forms: tuple[str, ...]) -> Covariates:
        model = self.model((piece,), forms)
        run = model.run(0, start, shared)
        rows, balls = np.nonzero(piece.seen)
        t = piece.t - piece.t[0]
        states = np.nan_to_num(run.at(t))
        since, contact = last_contacts(run, t)
        slip = np.linalg.norm(slips(states, run.balls.radius)[..., 4:6], axis=-1)
        place, velocity = states[rows, balls, :2], states[rows, balls, 2:4]
        phases = tuple(
            _phase(contact[row, ball], since[row, ball], slip[row, ball], float(np.hypot(*states[row, ball, 2:4])))
            for row, ball in zip(rows, balls, strict=True)
        )
        image = (place - self.picture.middle) * self.picture.px_per_m
        return Covariates(phases, place, velocity, since[rows, balls], image)

    def predict(self, piece: Recording, start: FloatArray, shared: FloatArray, forms: tuple[str, ...]) -> FloatArray:
        return self.model((piece,), forms).path_seen(0, start, shared)

    @property
    def _view(self) -> View:
        return View(self.picture.middle, self.table.length / 2, self.picture.height)

    def _priors(self) -> tuple[Prior, ...]:
        return tuple(replace(p, name=f"{effect.name}.{p.name}") for effect in self.effects for p in effect.parameters)

    def _stretch(self, piece: Recording, follows: bool) -> Stretch:
        """Of pieces that were seen before, what was made of them then: every hypothesis is fitted to the same ones."""
        key = id(piece), follows
        if key not in self._made:
            self._made[key] = piece, self._fresh_stretch(piece, follows)
        return self._made[key][1]

    def _fresh_stretch(self, piece: Recording, follows: bool) -> Stretch:
        start, moving = beginning(piece.t, piece.places, piece.sigma)
        whiten = np.eye(2) / piece.sigma[..., None, None]
        row = self._view.rows(piece.places)
        late = np.zeros(len(piece.t))
        for shot, t, interval in self.jumps:
            if shot == piece.shot:
                late = np.where(piece.t >= t, interval, 0.0) if piece.t[0] < t else late
        return Stretch(
            piece.shot, float(piece.t[0]), piece.t, piece.places, whiten, start, moving, follows, row, late
        )  # fmt: skip


def billiards_scene(
    table: Table, recordings: tuple[Recording, ...], picture: Picture | None = None,
    assumed: tuple[str, ...] = USUAL_MODEL, laws: Laws | None = None,
) -> BilliardsScene:  # fmt: skip
    """The scene of these recordings; without a picture the table is taken to fill it, 350 px to the metre."""
    around = Picture(np.array([table.length, table.width]) / 2, table.width, 350.0)
    jumps = tuple(jump for recording in recordings for jump in _jumps(recording, table))
    if jumps:  # a camera that loses pictures loses them near contacts too
        jumps = tuple(jump for recording in recordings for jump in _jumps(recording, table, expected=True))
    shown = around if picture is None else picture
    # where no shot leaps ahead none can have lost pictures: that is an answer, not an effect that might be missed
    held = tuple(one for one in BILLIARDS if one.name != "dropped_frames" or jumps or one.name in assumed)
    return BilliardsScene(table, shown, assumed, Laws() if laws is None else laws, jumps, held)


def last_contacts(run: Run, t: FloatArray) -> tuple[FloatArray, NDArray[np.str_]]:
    """(T, N) s since each ball last touched something, NaN where it has not; (T, N) `ball`, `cushion` or empty."""
    since = np.full((len(t), len(run.balls.ids)), np.nan)
    kind = np.full(since.shape, "", dtype="<U7")
    for contact in run.contacts[run.contacts[:, KIND] != HOLE]:
        met = contact[[FIRST, SECOND]] if contact[KIND] == BALL else contact[[FIRST]]
        later = t >= contact[TIME]
        for ball in met.astype(int):
            since[later, ball] = t[later] - contact[TIME]
            kind[later, ball] = "ball" if contact[KIND] == BALL else "cushion"
    return since, kind


def _phase(contact: str, since: float, slip: float, speed: float) -> str:
    """Of one ball at one moment."""
    if speed < _RESTS:
        return "rest"
    if contact and (since < _CONTACT or slip > _SLIPS):
        return f"{contact}_contact"
    return "after_strike" if slip > _SLIPS else "free_roll"


def _follow_directly(one: Recording, other: Recording) -> bool:
    """Whether a piece begins with the row after the last one of the piece before."""
    step = float(np.median(np.diff(one.t))) if len(one.t) > 1 else 0.0
    return one.shot == other.shot and 0 < other.t[0] - one.t[-1] < 1.5 * step


def _jumps(recording: Recording, table: Table, expected: bool = False) -> list[tuple[int, float, float]]:
    """Where pictures seem to be missing: shot, time of the first picture after them, time between two pictures."""
    if len(recording.t) < 2:
        return []
    interval = float(np.median(np.diff(recording.t)))
    found = time_jumps(_tracks(recording, table), interval, expected=expected)
    return [(recording.shot, float(recording.t[jump.after + 1]), interval) for jump in found[:1]]


def _tracks(recording: Recording, table: Table) -> Tracks:
    """A recording as tracks of sharp balls."""
    sigma = np.where(recording.seen, recording.sigma, np.nan)
    count = len(recording.bodies)
    return Tracks(
        recording.frame, recording.t, recording.bodies, ("ball",) * count, recording.places, recording.places,
        sigma, sigma, np.zeros_like(recording.places), np.full(sigma.shape, table.ball_radius), np.zeros((count, 3)),
    )  # fmt: skip
