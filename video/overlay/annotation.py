"""A shot's drawing, prepared once: who moved where and when, what happened, and where the panels stand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from models.core.fit_result import Fit, Light
from models.core.tracks import Tracks
from models.core.typing import FloatArray, ImageArray
from video.drawing.label_layout import Rect, Side, covered_share, place_label, place_panel
from video.drawing.palette import Colour, apart_from, ball_colour, lab_to_rgb
from video.drawing.table_inset import Inset, plan_of
from video.io.options import RenderOptions, Style
from video.matting.ball_timeline import Sightings
from video.overlay.frame_overlay import Balls, Clock, Label, draw_flash, draw_measured, draw_trail, uncovered, unit
from video.overlay.motion_marks import Mark, Path, marks_of, path_of

TRAIL_SECONDS = 0.9
"""s of the shot that a trail keeps."""
FLASH_SECONDS = 0.15
"""s of the shot that a contact flashes."""
READING_SECONDS = 2.0
"""s of the finished video that the time of a contact stays to be read."""
PLAN_STEP = 3
"""Points of a path per point of the plan, which is small."""
MOST_LABELS, MOST_TIMES = 6, 3
"""Balls named, and contact times shown, at once: more would hide the shot."""
TURN_SHARE = 0.12
"""Share of its way round the ball that a label goes per picture: it glides, it does not jump."""
MOST_COVERED, MOST_WORDS = 0.4, 0.08
"""Share of a label over other things, and over other labels, from which it fades."""
COME_STEP, GO_STEP = 0.1, 0.34
"""Change of a label's opacity per picture: two labels that meet are unreadable, so one goes at once."""
INSET_SHARE = 0.23
"""Longer side of the plan, share of the picture's width."""
COST_STEP = 8
"""px of the picture per cell of the map of what a panel would hide."""
TABLE_COST, POCKET_COST, PATH_COST, DETAIL_COST = 1.0, 2.0, 20.0, 1.5
TRUST_WORDS: dict[Light, str] = {"green": "fit trusted", "amber": "fit with care", "red": "fit not trusted"}


EIGHTFOLD = RenderOptions()
"""The usual slow motion."""


@dataclass(slots=True)
class Annotation:
    """All that is drawn over the pictures of a shot; it remembers where labels were, so draw in the order of time."""

    sightings: Sightings
    colours: tuple[Colour, ...]
    halos: tuple[Colour, ...]
    """Of the trails."""
    names: tuple[str, ...]
    paths: tuple[Path, ...]
    marks: tuple[Mark, ...]
    inset: Inset
    inset_place: Rect
    plan: ImageArray
    """The ground of the inset with the paths so far."""
    clock: Clock
    clock_place: Rect
    scale: float
    reading: float
    """s of the shot that a contact's time is shown."""
    sides: dict[int, tuple[Side, Side]] = field(default_factory=dict)
    """Where the label of a ball is to be, and on its way there where it is."""
    clear: dict[int, float] = field(default_factory=dict)
    """Opacity of the label of a ball: it fades where there is no room."""
    named: list[Rect] = field(default_factory=list)
    """Where the names stood on the picture before."""
    mark_sides: dict[int, Side] = field(default_factory=dict)
    """Where the label of a mark is."""
    crowded: set[int] = field(default_factory=set)
    """Marks for whose label there was no room."""
    style: Style = "coach"
    planned: dict[int, int] = field(default_factory=dict)
    """The last point of a ball's path on it."""

    def draw(self, picture: ImageArray, t: float, balls: Balls, xy: FloatArray) -> None:
        """Draw on `picture` (H, W, 3), in place; `xy` (N, 2) m are the places of the balls."""
        if self.style == "clean":
            if self.clock.light != "green":
                self.clock.draw(picture, self.clock_place, t, self.scale)
            return
        if self.style == "coach":
            free = uncovered(picture.shape, balls)
            for ball, path in enumerate(self.paths):
                self._trail(picture, t, path, balls.centre[ball], self.halos[ball], free)
        draw_measured(picture, balls, self.colours, self.scale)
        for mark in self.marks:
            if 0 <= t - mark.t < FLASH_SECONDS:
                centre = self.sightings.project(mark.xy, t)
                radius = balls.radius_of(mark.ball)
                draw_flash(picture, centre, radius, (t - mark.t) / FLASH_SECONDS, self.scale, mark.strength)
        self._panels(picture, t, xy)
        taken = [self.inset_place, self.clock_place, *balls.boxes(0.6)]
        things = len(taken)
        self._times(picture, t, balls, taken)
        if self.style == "coach":
            self._names(picture, t, balls, taken, things)

    def _trail(
        self, picture: ImageArray, t: float, path: Path, centre: FloatArray, colour: Colour, free: ImageArray
    ) -> None:
        first, last = path.t.searchsorted([t - TRAIL_SECONDS, t])
        if last - first < 1:
            return
        points = path.drawn[np.searchsorted(path.drawn, first) : np.searchsorted(path.drawn, last)]
        way = self.sightings.shown(path.px[points], t)
        age = (t - path.t[points]) / TRAIL_SECONDS
        if np.isfinite(centre).all():
            way, age = np.concatenate([way, centre[None]]), np.append(age, 0.0)
        fade = np.clip(1 - age, 0, 1) ** 1.3
        width = float(np.clip(0.42 * path.radius, 2.2, 9 * self.scale))
        draw_trail(picture, way, fade, colour, width, free)

    def _panels(self, picture: ImageArray, t: float, xy: FloatArray) -> None:
        for ball, path in enumerate(self.paths):
            first, last = self.planned.get(ball, 0), int(path.t.searchsorted(t))
            if last - first > PLAN_STEP:
                points = np.arange(first, last, PLAN_STEP)
                self.inset.add_path(self.plan, path.xy[points], self.colours[ball])
                self.planned[ball] = int(points[-1])
        left, top = (round(v) for v in self.inset_place[:2])
        self.inset.lay(picture, left, top, self.plan, xy, self.colours)
        self.clock.draw(picture, self.clock_place, t, self.scale)

    def _times(self, picture: ImageArray, t: float, balls: Balls, taken: list[Rect]) -> None:
        """Times of the last contacts, each where it was first put."""
        fresh = [k for k, mark in enumerate(self.marks) if 0 <= t - mark.t < self.reading]
        for k in fresh[-MOST_TIMES:]:
            mark, spot = self.marks[k], self.sightings.project(self.marks[k].xy, t)
            size, radius = mark.label.size(self.scale), 1.6 * balls.radius_of(mark.ball)
            if k not in self.mark_sides:
                obstacles = [*taken, *self.named, *self._soon(t)]
                self.mark_sides[k] = place_label(size, spot, radius, np.zeros(2), obstacles, _bounds(picture), None)
                rect = (*(spot + self.mark_sides[k].corner(size, radius)), *size)
                self.crowded |= {k} if covered_share(rect, taken) > MOST_COVERED else set()
            if k in self.crowded:
                continue
            age = (t - mark.t) / self.reading
            opacity = float(np.clip(min(age * 12, (1 - age) * 5), 0, 1))
            _put(picture, mark.label, spot + self.mark_sides[k].corner(size, radius), self.scale, opacity, taken)

    def _soon(self, t: float) -> list[Rect]:
        """Squares that balls will cross while a label can be read."""
        ways = [path.px[(path.t > t) & (path.t < t + self.reading)][::6] for path in self.paths]
        half = 12 * self.scale
        places = self.sightings.shown(np.concatenate(ways), t)
        return [(float(x) - half, float(y) - half, 2 * half, 2 * half) for x, y in places]

    def _names(self, picture: ImageArray, t: float, balls: Balls, taken: list[Rect], things: int) -> None:
        """Name and speed beside the balls that move or have just come to rest; labels are `taken` from `things` on."""
        shown = [int(ball) for ball in balls.present if self._presence(t, int(ball)) > 0 and balls.sure[ball]]
        shown.sort(key=lambda ball: (-len(self.paths[ball].t), ball))
        others = len(taken)
        for ball in shown[:MOST_LABELS]:
            speed = balls.speed[ball]
            label = Label(self.names[ball], f"{speed:.2f} m/s" if np.isfinite(speed) else "", self.colours[ball])
            size, centre, radius = label.size(self.scale), balls.centre[ball], balls.radius_of(ball)
            aim, now = self.sides.get(ball, (None, None))
            aim = place_label(size, centre, radius, balls.heading[ball], taken, _bounds(picture), aim)
            now = aim if now is None else now.towards(aim, TURN_SHARE)
            self.sides[ball] = aim, now
            corner = centre + now.corner(size, radius)
            rect = (*corner, *size)
            words = covered_share(rect, taken[things:])
            room = covered_share(rect, taken) < MOST_COVERED and words < MOST_WORDS
            clear = self.clear.get(ball, float(room)) + (COME_STEP if room else -GO_STEP)
            self.clear[ball] = float(np.clip(clear, 0, 1))
            _put(picture, label, corner, self.scale, self._presence(t, ball) * self.clear[ball], taken)
        self.named = taken[others:]

    def _presence(self, t: float, ball: int) -> float:
        """Opacity of a ball's name: it comes and goes with its motion."""
        most = 0.0
        for start, end in self.paths[ball].spans.tolist():
            since = (t - start) / (0.1 * self.reading)
            left = (end + 0.3 * self.reading - t) / (0.2 * self.reading)
            most = max(most, min(since, left, 1.0))
        return most


def _bounds(picture: ImageArray) -> tuple[int, int]:
    """Width and height."""
    return picture.shape[1], picture.shape[0]


def _put(
    picture: ImageArray, label: Label, corner: FloatArray, scale: float, opacity: float, taken: list[Rect]
) -> None:
    """Draw a label inside the picture, and note that its place is taken."""
    if opacity <= 0:
        return
    size = np.array(label.size(scale), dtype=np.float64)
    left, top = np.maximum(np.minimum(corner, _bounds(picture) - size - 2), 2)
    label.draw(picture, np.array([left, top]), scale, opacity)
    taken.append((float(left), float(top), float(size[0]), float(size[1])))


def annotate(
    sightings: Sightings, tracks: Tracks, fit: Fit, first: ImageArray, slow: float, style: Style = "coach"
) -> Annotation:
    """Prepare the drawing of a shot that is shown `slow` times slower; `first` (H, W, 3) is its first picture."""
    height, width = first.shape[:2]
    scale = unit(height)
    paths = tuple(path_of(sightings, fit, ball) for ball in range(len(tracks.ids)))
    inset = plan_of(sightings.scene, round(INSET_SHARE * width))
    clock = Clock(f"{slow:g}× slower", fit.trust.light, TRUST_WORDS[fit.trust.light])
    cost = _cost(sightings, paths, first)
    inset_place = place_panel(inset.size, (width, height), cost, [], 1 / COST_STEP)
    clock_place = place_panel(clock.size(scale), (width, height), cost, [inset_place], 1 / COST_STEP)
    colours = tuple(ball_colour(kind, lab) for kind, lab in zip(tracks.kinds, tracks.colour, strict=True))
    cloth = lab_to_rgb(sightings.scene.cloth_lab)
    return Annotation(
        sightings=sightings, names=tracks.ids, paths=paths, marks=marks_of(sightings, fit), inset=inset,
        colours=colours, halos=tuple(apart_from(colour, cloth) for colour in colours),
        inset_place=inset_place, plan=inset.ground.copy(), clock=clock, clock_place=clock_place, scale=scale,
        reading=READING_SECONDS / slow, style=style,
    )  # fmt: skip


def _cost(sightings: Sightings, paths: Sequence[Path], first: ImageArray) -> FloatArray:
    """What a panel would hide, on a coarse map (h, w): table, balls and paths, and what else there is to see."""
    height, width = (-(-side // COST_STEP) for side in first.shape[:2])
    grey = cv2.cvtColor(cv2.resize(first, (width, height), interpolation=cv2.INTER_AREA), cv2.COLOR_RGB2GRAY)
    detail = np.minimum(np.abs(cv2.Laplacian(grey, cv2.CV_32F)) / 60, 1) * DETAIL_COST
    table = np.zeros((height, width), dtype=np.uint8)
    cv2.fillPoly(table, [np.rint(sightings.scene.camera.corners_px / COST_STEP).astype(np.int32)], 1)
    used: ImageArray = np.zeros((height, width), dtype=np.uint8)
    start = float(sightings.t[0])
    balls = sightings.centre[[0, -1]].reshape(-1, 2)
    pockets: ImageArray = np.zeros((height, width), dtype=np.uint8)
    for x, y in sightings.project(sightings.scene.table.pocket_centres, start) / COST_STEP:
        cv2.circle(pockets, (round(x), round(y)), 5, 1, -1)
    for places in (*(sightings.project(path.xy, start) for path in paths), balls):
        for x, y in places[np.isfinite(places[:, 0])] / COST_STEP:
            cv2.circle(used, (round(x), round(y)), 3, 1, -1)
    return np.asarray(detail + table * TABLE_COST + pockets * POCKET_COST + used * PATH_COST, dtype=np.float64)
