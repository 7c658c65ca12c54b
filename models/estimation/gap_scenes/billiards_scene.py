"""Billiards under diagnosis: whole shots, all effects of the catalogue, published contact models.

Frames may be missing without a trace in their times: everything that moves jumps ahead at once.
A ball that jumps ahead keeps its direction and its speed, which no contact does. Around every frame, the paths of all
moving balls are therefore fitted by parabolas in a time with a pause of 0, 1, 2, ... frames; the pause of least chi2 is
accepted where it explains the paths well.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from models.core.recording import Recording
from models.core.scene import Table
from models.core.typing import BoolArray, FloatArray
from models.estimation.gap_scenes.foreign_shots import BilliardsSimulator, ForeignShotWindows, state_effects
from models.estimation.gap_scenes.gap_scene import Alternatives, Covariates
from models.estimation.multiple_shooting.shooting_problem import LEAST_GAIN
from models.estimation.whole_shot.shot_segments import ShotSegment, estimate_initial_states, find_shot_rows
from models.estimation.whole_shot.shot_windows import ShotWindows
from models.physics.billiards.contact_model import NOSE_HEIGHT_PARAMETER
from models.physics.billiards.contact_models import REGISTERED_CUSHION_MODELS
from models.physics.billiards.simulation.event_engine import (
    BALL,
    EVENT_FIRST,
    EVENT_KIND,
    EVENT_SECOND,
    EVENT_TIME,
    HOLE,
)
from models.physics.billiards.simulation.parametrised_shot import ContactModels, ImagePlacement, convert_to_starts
from models.physics.billiards.simulation.simulated_shot import SimulatedShot
from models.physics.billiards.simulation.table_physics import BILLIARDS_MODEL_CHOICES
from models.physics.effect import Effect, Prior
from models.physics.effects.billiards_catalogue import BILLIARDS_EFFECTS

# Effects of a simulator that is not specified.
DEFAULT_EFFECTS = (
    "rolling_resistance", "sliding_friction", "spin_decay", "cushion_restitution", "ball_restitution",
)  # fmt: skip
# s for which an observation counts as affected by a contact, even where the ball rolls again.
_CONTACT_DURATION = 0.25
# m/s of slip above which a ball slides.
_MIN_SLIP = 0.01
# m/s below which a ball rests.
_MAX_REST_SPEED = 1e-3


@dataclass(frozen=True, slots=True)
class ImageGeometry:
    """Position and scale of the image on the table plane."""

    centre: FloatArray
    """(2,) m, position of the image centre."""
    height: float
    """m that the image height covers."""
    px_per_m: float


@dataclass(frozen=True, slots=True)
class BilliardsScene:
    """Billiards as a `models.estimation.gap_scenes.gap_scene.GapScene`."""

    table: Table
    image: ImageGeometry
    simulator_effects: tuple[str, ...] = DEFAULT_EFFECTS
    laws: ContactModels = field(default_factory=ContactModels)
    """Contact models of the simulator."""
    jumps: tuple[tuple[int, float, float], ...] = ()
    """Shot, time (s) from which on frames appear to be missing, and frame interval (s)."""
    effects: tuple[Effect, ...] = BILLIARDS_EFFECTS
    name: str = "billiards"
    gauges: tuple[str, ...] = ("frame_rate", "time_offset", "parallax_shift")
    not_tested: tuple[str, ...] = ()
    is_smooth: bool = False
    least_gain: float = LEAST_GAIN
    simulator: BilliardsSimulator | None = None
    """The user's own engine; None where it is ours."""
    _segment_cache: dict[tuple[int, bool], tuple[Recording, ShotSegment]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )
    """Segments by the `id` of their recording, which is stored so that no other object takes its id."""
    initial_window_length: float = 0.5
    """s: within half a second a ball rarely has more than one contact, see
    `models.estimation.gap_scenes.gap_scene.ContactRichScene`."""

    @property
    def has_stated_values(self) -> bool:
        """Whether an engine from outside states its parameters."""
        return self.simulator is not None

    @property
    def alternatives(self) -> tuple[Alternatives, ...]:
        """Contact models of cushions and of balls; without loss and friction, `elastic` equals `inelastic`."""
        cushion, ball = BILLIARDS_MODEL_CHOICES
        standard_values = {model.name: dict(model.standard_values) for model in REGISTERED_CUSHION_MODELS}
        if self.simulator is not None:  # its cushions keep their height, whatever the model
            for form in standard_values:
                if NOSE_HEIGHT_PARAMETER in self.simulator.holds(ContactModels(form, self.laws.ball)):
                    standard_values[form] = {NOSE_HEIGHT_PARAMETER: self.simulator.nose_height}
        of_balls = tuple(form for form in ball.forms if form != "elastic" or self.laws.ball == "elastic")
        # a law that brings its friction is not replaced by one without any
        companions = ("ball_friction",) if self.laws.ball == "alciatore" else ball.companions
        return (
            Alternatives(
                cushion.name, cushion.forms, self.laws.cushion, cushion.phases, cushion.companions, standard_values
            ),
            Alternatives(ball.name, of_balls, self.laws.ball, ball.phases, companions),
        )

    def split_recording(self, recording: Recording) -> tuple[Recording, ...]:
        """Split a recording at every strike."""
        return tuple(recording.select_rows(*rows) for rows in find_shot_rows(recording.positions, recording.sigma))

    def find_bridged_rows(self, segment: Recording) -> tuple[int, ...]:
        """Find the first row after every time jump of a segment."""
        rows = (int(np.searchsorted(segment.t, t)) for shot, t, _ in self.jumps if shot == segment.shot)
        return tuple(row for row in rows if 0 < row < len(segment.t))

    def build_model(
        self, segments: tuple[Recording, ...], forms: tuple[str, ...], jacobian_mask: BoolArray | None = None
    ) -> ShotWindows:
        """Build the model of whole segments; spin continues where one follows another directly."""
        follows = [False, *(_follow_directly(one, other) for one, other in pairwise(segments))]
        shot_segments = tuple(
            self._look_up_segment(segment, after) for segment, after in zip(segments, follows, strict=True)
        )
        arguments = shot_segments, self.table, self._effect_priors(), ContactModels(*forms)
        if self.simulator is None:
            return ShotWindows(*arguments, view=self._camera_view, jacobian_mask=jacobian_mask)
        return ForeignShotWindows(
            *arguments, view=self._camera_view, jacobian_mask=jacobian_mask, simulator=self.simulator
        )

    def observation_covariates(
        self, segment: Recording, start: FloatArray, shared: FloatArray, forms: tuple[str, ...]
    ) -> Covariates:
        """Compute the covariates of the observations of a segment, from a simulation."""
        rows, balls = np.nonzero(segment.is_observed)
        run = self.build_model((segment,), forms).simulate_possible_run(0, start, shared)
        if run is None:
            place, unknown = segment.positions[rows, balls], np.full(len(rows), np.nan)
            image = (place - self.image.centre) * self.image.px_per_m
            return Covariates(("rest",) * len(rows), place, np.zeros_like(place), unknown, image)
        t = segment.t - segment.t[0]
        states = np.nan_to_num(run.states_at(t))
        since, contact = find_last_contacts(run, t)
        slip = np.linalg.norm(convert_to_starts(states, run.balls.radius)[..., 4:6], axis=-1)
        place, velocity = states[rows, balls, :2], states[rows, balls, 2:4]
        phases = tuple(
            _classify_phase(
                contact[row, ball], since[row, ball], slip[row, ball], float(np.hypot(*states[row, ball, 2:4]))
            )
            for row, ball in zip(rows, balls, strict=True)
        )
        image = (place - self.image.centre) * self.image.px_per_m
        return Covariates(phases, place, velocity, since[rows, balls], image)

    def predict_positions(
        self, segment: Recording, start: FloatArray, shared: FloatArray, forms: tuple[str, ...]
    ) -> FloatArray:
        """Predict where every ball would be observed at every row of a segment."""
        return self.build_model((segment,), forms).predict_observed_path(0, start, shared)

    @property
    def _camera_view(self) -> ImagePlacement:
        return ImagePlacement(self.image.centre, self.table.length / 2, self.image.height)

    def _effect_priors(self) -> tuple[Prior, ...]:
        return tuple(replace(p, name=f"{effect.name}.{p.name}") for effect in self.effects for p in effect.parameters)

    def _look_up_segment(self, segment: Recording, follows: bool) -> ShotSegment:
        """Return the segment of a recording, computed once: every hypothesis is fitted to the same one."""
        key = id(segment), follows
        if key not in self._segment_cache:
            self._segment_cache[key] = segment, self._extract_segment(segment, follows)
        return self._segment_cache[key][1]

    def _extract_segment(self, segment: Recording, follows: bool) -> ShotSegment:
        start, moving = estimate_initial_states(segment.t, segment.positions, segment.sigma)
        whiten = np.eye(2) / segment.sigma[..., None, None]
        row = self._camera_view.image_rows(segment.positions)
        late = np.zeros(len(segment.t))
        for shot, t, interval in self.jumps:
            if shot == segment.shot:
                late = np.where(segment.t >= t, interval, 0.0) if segment.t[0] < t else late
        return ShotSegment(
            segment.shot, float(segment.t[0]), segment.t, segment.positions, whiten, start, moving, follows, row, late
        )  # fmt: skip


def build_billiards_scene(
    table: Table, recordings: tuple[Recording, ...], image: ImageGeometry | None = None,
    simulator_effects: tuple[str, ...] = DEFAULT_EFFECTS, laws: ContactModels | None = None,
) -> BilliardsScene:  # fmt: skip
    """Build the billiards scene of some recordings.

    Args:
        table: Dimensions of the table.
        recordings: Recordings of shots.
        image: Position and scale of the image; without it, the table is assumed to fill it at 350 px/m.
        simulator_effects: Names of the effects that the user's simulator has.
        laws: Contact models of the simulator.

    Returns:
        The scene. Dropped frames are only offered as an effect where a shot shows a time jump.
    """
    around = ImageGeometry(np.array([table.length, table.width]) / 2, table.width, 350.0)
    jumps = tuple(jump for recording in recordings for jump in _find_jumps(recording))
    if jumps:  # a camera that drops frames also drops them near contacts
        jumps = tuple(jump for recording in recordings for jump in _find_jumps(recording, expected=True))
    geometry = around if image is None else image
    # without a time jump no frame can be missing: dropped frames are then refuted, not untested
    offered = tuple(
        one for one in BILLIARDS_EFFECTS if one.name != "dropped_frames" or jumps or one.name in simulator_effects
    )
    return BilliardsScene(table, geometry, simulator_effects, ContactModels() if laws is None else laws, jumps, offered)


def pair_with_simulator(scene: BilliardsScene, simulator: BilliardsSimulator) -> BilliardsScene:
    """Let another engine play the shots of a scene, with the effects, values and contact models that it has.

    Args:
        scene: Scene of our own engine.
        simulator: The user's engine.

    Returns:
        The scene of the other engine.
    """
    effects = state_effects(scene.effects, simulator)
    own = {name.partition(".")[0] for name in simulator.holds(simulator.laws) & simulator.stated.keys()}
    names = tuple(effect.name for effect in effects if effect.name in own)
    return replace(scene, simulator=simulator, effects=effects, simulator_effects=names, laws=simulator.laws)


def find_last_contacts(run: SimulatedShot, t: FloatArray) -> tuple[FloatArray, NDArray[np.str_]]:
    """Find the last contact of each ball before each time.

    Args:
        run: Simulated shot.
        t: (T,) s.

    Returns:
        (T, N) s since the last contact, NaN where there was none, and (T, N) `ball`, `cushion` or empty.
    """
    since = np.full((len(t), len(run.balls.ids)), np.nan)
    kind = np.full(since.shape, "", dtype="<U7")
    for contact in run.contacts[run.contacts[:, EVENT_KIND] != HOLE]:
        met = contact[[EVENT_FIRST, EVENT_SECOND]] if contact[EVENT_KIND] == BALL else contact[[EVENT_FIRST]]
        later = t >= contact[EVENT_TIME]
        for ball in met.astype(int):
            since[later, ball] = t[later] - contact[EVENT_TIME]
            kind[later, ball] = "ball" if contact[EVENT_KIND] == BALL else "cushion"
    return since, kind


def _classify_phase(contact: str, since: float, slip: float, speed: float) -> str:
    """Classify the motion phase of one ball at one time."""
    if speed < _MAX_REST_SPEED:
        return "rest"
    if contact and (since < _CONTACT_DURATION or slip > _MIN_SLIP):
        return f"{contact}_contact"
    return "after_strike" if slip > _MIN_SLIP else "free_roll"


def _follow_directly(one: Recording, other: Recording) -> bool:
    """Return whether a segment begins with the row after the last one of the previous segment."""
    step = float(np.median(np.diff(one.t))) if len(one.t) > 1 else 0.0
    return one.shot == other.shot and 0 < other.t[0] - one.t[-1] < 1.5 * step


def _find_jumps(recording: Recording, expected: bool = False) -> list[tuple[int, float, float]]:
    """Find missing frames: shot, time of the first frame after them, and frame interval."""
    if len(recording.t) < 2:
        return []
    interval = float(np.median(np.diff(recording.t)))
    jumps = find_time_jumps(recording, interval, expected=expected)
    return [(recording.shot, float(recording.t[jump.after + 1]), interval) for jump in jumps[:1]]


# Frames on either side: a parabola is a good model over twice as many.
_FRAMES_PER_SIDE = 6
# Least frames on a side near a contact.
_MIN_FRAMES_PER_SIDE = 4
# Largest number of frames lost at once.
_MAX_LOST_FRAMES = 15
# Decrease of chi2 that a pause must achieve.
_MIN_CHI2_GAIN = 40.0
# chi2 per degree of freedom up to which a pause explains the paths.
_MAX_CHI2 = 3.0
# Share of the larger of two velocities that the smaller one keeps along it: a strike or a contact keeps less.
_MIN_VELOCITY_SHARE = 0.4


@dataclass(frozen=True, slots=True)
class TimeJump:
    """Frames lost after one frame."""

    after: int
    """Row of the recording after which they are missing."""
    lost_frames: int
    """Number of missing frames."""
    gain: float
    """Decrease of chi2 by the pause."""


def find_time_jumps(recording: Recording, interval: float, expected: bool = False) -> tuple[TimeJump, ...]:
    """Find lost frames, in the order of time.

    Args:
        recording: Recording of a shot.
        interval: s between frames.
        expected: Whether other recordings of the same camera lack frames. Contacts nearby are then no evidence against
            them: a ball is fitted over fewer frames, or ignored where no pause explains it.

    Returns:
        One jump per place of lost frames.
    """
    jumps: list[TimeJump] = []
    times = recording.t
    for _ in range(len(recording.t)):
        candidates = (_find_jump_after(recording, times, row, interval, expected) for row in range(len(times) - 1))
        best = max(candidates, key=lambda jump: jump.gain, default=None)
        if best is None or best.gain < _MIN_CHI2_GAIN or any(best.after == earlier.after for earlier in jumps):
            break
        jumps.append(best)
        times = add_pauses(recording.t, tuple(jumps), interval)
    return tuple(sorted(jumps, key=lambda jump: jump.after))


def add_pauses(t: FloatArray, jumps: tuple[TimeJump, ...], interval: float) -> FloatArray:
    """Convert presentation times (T,) into capture times by inserting the pauses of lost frames.

    Args:
        t: (T,) s.
        jumps: Lost frames.
        interval: s between frames.

    Returns:
        (T,) s.
    """
    taken = t.copy()
    for jump in jumps:
        taken[jump.after + 1 :] += jump.lost_frames * interval
    return taken


def _find_jump_after(recording: Recording, times: FloatArray, row: int, interval: float, expected: bool) -> TimeJump:
    """Find the pause after `row` that all moving balls together support best; its gain is 0 where there is none."""
    rows = np.arange(max(row - _FRAMES_PER_SIDE + 1, 0), min(row + _FRAMES_PER_SIDE + 1, len(times)))
    if row - rows[0] + 1 < _FRAMES_PER_SIDE - 1 or rows[-1] - row < _FRAMES_PER_SIDE - 1:
        return TimeJump(row, 0, 0.0)
    chi2, free = np.zeros(_MAX_LOST_FRAMES + 1), 0
    for ball, is_observed in enumerate(recording.is_observed[rows].T):
        observed_rows = rows[is_observed]
        before = int((observed_rows <= row).sum())
        if min(before, len(observed_rows) - before) < _MIN_FRAMES_PER_SIDE:
            continue
        t, xy = times[observed_rows], recording.positions[observed_rows, ball]
        sigma = recording.sigma[observed_rows, ball]
        for part in _list_row_ranges(before, len(observed_rows)) if expected else (slice(0, len(observed_rows)),):
            own_before, own_free = before - part.start, 2 * (part.stop - part.start) - 6
            if not _keeps_velocity(t[part], xy[part], own_before):
                continue
            own = _parabola_chi2(t[part], xy[part], sigma[part], own_before, interval)
            if not expected or own.min() <= _MAX_CHI2 * own_free:
                chi2 += own
                free += own_free
                break
    lost = int(np.argmin(chi2))
    if free == 0 or chi2[lost] > _MAX_CHI2 * free:
        return TimeJump(row, 0, 0.0)
    return TimeJump(row, lost, float(chi2[0] - chi2[lost]))


def _list_row_ranges(before: int, count: int) -> list[slice]:
    """List the ranges of samples on both sides of a pause that can be fitted, the longest first."""
    narrow = max(before - _MIN_FRAMES_PER_SIDE, 0), min(before + _MIN_FRAMES_PER_SIDE, count)
    parts = [slice(first, last) for first in (0, narrow[0]) for last in (count, narrow[1])]
    return sorted(parts, key=lambda part: part.start - part.stop)


def _keeps_velocity(t: FloatArray, xy: FloatArray, before: int) -> bool:
    """Return whether samples (n,) keep their velocity between the first `before` of them and the others."""
    one = (xy[before - 1] - xy[0]) / (t[before - 1] - t[0])
    two = (xy[-1] - xy[before]) / (t[-1] - t[before])
    return float(one @ two) > _MIN_VELOCITY_SHARE * max(float(one @ one), float(two @ two))


def _parabola_chi2(t: FloatArray, xy: FloatArray, sigma: FloatArray, before: int, interval: float) -> FloatArray:
    """Compute chi2 of parabolas through samples (n,) with a pause of 0, 1, ... lost frames after the first `before`."""
    lost_frames = np.arange(_MAX_LOST_FRAMES + 1)[:, None] * (np.arange(len(t)) >= before)
    times = (t - t[before - 1]) / interval + lost_frames
    basis = np.linalg.qr(np.stack([times**2, times, np.ones_like(times)], axis=2) / sigma[:, None])[0]
    target = xy / sigma[:, None]
    return np.asarray(np.square(target - basis @ (basis.swapaxes(1, 2) @ target)).sum(axis=(1, 2)))
