"""Random short films of a small flying object before moving shapes: what the flying-object network is trained on.

Nothing in them is a real court. Backgrounds, people, light, lens, sharpening, noise and compression vary more than
those of real films do (Tobin et al. 2017, doi:10.1109/IROS.2017.8202133): a real film is one more variation.
"""

from __future__ import annotations

import io
from dataclasses import dataclass

import av
import cv2
import numpy as np

from models.core.typing import ByteArray, Float32Array, FloatArray

# Columns, rows and frames of a film, and samples of a frame's exposure in which people are drawn.
WIDTH, HEIGHT, FRAMES, SUBFRAMES = 448, 288, 14, 5
# Objects in a film.
OBJECTS = 2
# Fixed-point bits of OpenCV's drawing, and the zoom at which the object is drawn.
SHIFT, ZOOM = 4, 4


@dataclass(frozen=True, slots=True)
class FlyingFilm:
    """T frames with the truth about N objects: more than one, because one would make few samples."""

    luma: ByteArray
    """(T, H, W)"""
    centre: FloatArray
    """(T, N, 2) px at mid-exposure."""
    streak: FloatArray
    """(T, N, 2) px."""
    visible: FloatArray
    """(T, N) share of the object that nothing hides, 0 outside the frame."""
    shifts: FloatArray
    """(T, 3, 3) homographies from px of the first frame to those of each, as a calibration would find them."""


def draw_film(rng: np.random.Generator) -> FlyingFilm:
    """Draw a random film."""
    still = rng.random() < 0.55
    pan = np.zeros(2) if still else rng.normal(0, 1, 2) * [3.0, 0.7] * rng.uniform(0.2, 1.5)
    zoom = 1.0 if still else float(np.exp(rng.normal(0, 0.0015)))
    wide = _draw_background(rng, WIDTH + 160, HEIGHT + 80)
    people = [Person(rng) for _ in range(rng.integers(0, 4))]
    flights = [Flight(rng) for _ in range(OBJECTS)]
    exposure = rng.uniform(0.05, 0.6) if rng.random() < 0.7 else rng.uniform(0.4, 1.0)
    # Some cameras and scalers alias: thin lines become beads that stay where the pixels are.
    sampling = cv2.INTER_NEAREST if rng.random() < 0.3 else cv2.INTER_LINEAR
    flashes = rng.exponential(1.0) * (rng.random() < 0.3)
    in_front = rng.random(len(people)) < 0.35
    board, flicker = _random_board(rng), rng.normal(0, 0.01 * (rng.random() < 0.3), FRAMES)
    frames, centres, streaks, shares, moves = [], [], [], [], []
    for k in range(FRAMES):
        move = np.array([[zoom**k, 0, pan[0] * k], [0, zoom**k, pan[1] * k], [0, 0, 1.0]])
        base = np.array([[1, 0, -80], [0, 1, -40], [0, 0, 1.0]])
        ground = cv2.warpPerspective(wide, move @ base, (WIDTH, HEIGHT), flags=sampling, borderMode=cv2.BORDER_REFLECT)
        _show_board(ground, board, k)
        times = k + exposure * ((np.arange(SUBFRAMES) + 0.5) / SUBFRAMES - 0.5)
        layers = [_draw_people(ground, people, in_front, t, move) for t in times]
        image = np.mean([layer[0] for layer in layers], axis=0, dtype=np.float32)
        hidden = np.mean([layer[1] for layer in layers], axis=0, dtype=np.float32) / 255
        for flight in flights:
            seen = flight.cover(k, exposure, move) * (1 - hidden)
            shares.append(float(seen.sum()) / flight.area())
            image += seen * (flight.level - image)
            ends = flight.place(np.array([k - exposure / 2, k, k + exposure / 2]), move)
            centres.append(ends[1])
            streaks.append(ends[2] - ends[0])
        for x, y, r, level in rng.uniform([0, 0, 1, 60], [WIDTH, HEIGHT / 2, 4, 255], (rng.poisson(flashes), 4)):
            cv2.circle(image, (int(x), int(y)), int(r), float(level), -1)
        frames.append(image * (1 + flicker[k]))
        moves.append(move)
    luma = _film(rng, np.stack(frames))
    jitter = np.zeros(2) if still else rng.normal(0, rng.uniform(0, 0.25), (FRAMES, 2))
    shifts = np.stack(moves)
    shifts[:, :2, 2] += jitter
    shape = (FRAMES, OBJECTS)
    centre, streak = (np.array(places).reshape(*shape, 2) for places in (centres, streaks))
    return FlyingFilm(luma, centre, streak, np.array(shares).reshape(shape), shifts)


class Flight:
    """A path in the plane of the first frame, with hits and bounces, and the object that takes it."""

    def __init__(self, rng: np.random.Generator) -> None:
        """Draw one at random."""
        self.radius = float(np.exp(rng.uniform(np.log(1.1), np.log(4.0))))
        self.is_shuttle = rng.random() < 0.5
        self.level = rng.uniform(140, 255) if rng.random() < 0.92 else rng.uniform(60, 160)
        self.opacity = rng.uniform(0.55, 1.0)
        self.times = np.sort(rng.uniform(-2, FRAMES + 2, rng.integers(0, 3)))
        speeds = np.exp(rng.uniform(np.log(0.6), np.log(45), len(self.times) + 1))
        angles = rng.uniform(0, 2 * np.pi, len(speeds))
        self.velocity = speeds[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
        self.fall = np.array([0, rng.uniform(0, 1.2)]) + rng.normal(0, 0.15, 2)
        self.middle = np.array([WIDTH, HEIGHT]) * rng.uniform(0.1, 0.9, 2)
        self.anchor = rng.uniform(0, FRAMES)
        self.outline = np.array([[-1.0, 0.55], [-1.0, -0.55], [1.6, -1.1], [1.6, 1.1]]) * rng.uniform(0.8, 1.2)

    def place(self, t: FloatArray, move: FloatArray) -> FloatArray:
        """Compute the places (K, 2), px of a frame, at times (K,)."""
        start = self._plain(np.array([self.anchor]))
        flat = self._plain(np.asarray(t, np.float64)) - start + self.middle
        flat = flat + 0.5 * self.fall * (np.asarray(t)[:, None] - self.anchor) ** 2
        return np.asarray(flat * move[0, 0] + move[:2, 2])

    def _plain(self, t: FloatArray) -> FloatArray:
        edges = np.concatenate([[-50.0], self.times, [FRAMES + 50.0]])
        spent = np.clip(t[:, None] - edges[:-1], 0, np.diff(edges))
        return np.asarray(spent @ self.velocity)

    def area(self) -> float:
        """Return the sum over px of the object's share when nothing hides it, without motion blur."""
        return float(self._stamp(np.array([40.0, 40.0]), np.array([1.0, 0.0]), 80).sum())

    def cover(self, k: int, exposure: float, move: FloatArray) -> Float32Array:
        """Draw the share (H, W) of each px's exposure that the object takes in frame k."""
        alpha = np.zeros((HEIGHT, WIDTH), np.float32)
        ends = self.place(np.array([k - exposure / 2, k + exposure / 2]), move)
        count = int(np.clip(np.linalg.norm(ends[1] - ends[0]) * 1.5, 4, 60))
        t = k + exposure * ((np.arange(count) + 0.5) / count - 0.5)
        places = self.place(t, move)
        ahead = self.place(t + 0.05, move) - places
        low = np.floor(places.min(axis=0)).astype(int) - 14
        side = int(np.ceil((places.max(axis=0) - low).max())) + 14
        if side > 400:
            return alpha
        stamps = [self._stamp(p - low, a, side) for p, a in zip(places, ahead, strict=True)]
        stamp = np.mean(stamps, axis=0, dtype=np.float32)
        x0, y0 = np.maximum(low, 0)
        x1, y1 = np.minimum(low + side, [WIDTH, HEIGHT])
        if x0 < x1 and y0 < y1:
            alpha[y0:y1, x0:x1] = stamp[y0 - low[1] : y1 - low[1], x0 - low[0] : x1 - low[0]]
        return alpha

    def _stamp(self, centre: FloatArray, ahead: FloatArray, side: int) -> Float32Array:
        """Draw the object (side, side) at a place, turned ahead."""
        canvas = np.zeros((side * ZOOM, side * ZOOM), np.uint8)
        unit = 2.0**SHIFT
        if self.is_shuttle:
            forward = ahead / (np.linalg.norm(ahead) + 1e-9)
            turn = np.column_stack([-forward, [-forward[1], forward[0]]])
            corners = centre + self.radius * (self.outline @ turn.T) - self.radius * 0.2 * -forward
            points = np.round(((corners + 0.5) * ZOOM - 0.5) * unit).astype(np.int32)
            cv2.fillPoly(canvas, [points], int(200 * self.opacity), cv2.LINE_AA, SHIFT)
            cork = centre + forward * self.radius * 0.9
            at, size = np.round(((cork + 0.5) * ZOOM - 0.5) * unit).astype(int), self.radius * 0.55
            cv2.circle(canvas, (int(at[0]), int(at[1])), round(size * ZOOM * unit), 255, -1, cv2.LINE_AA, SHIFT)
        else:
            at = np.round(((centre + 0.5) * ZOOM - 0.5) * unit).astype(int)
            cv2.circle(canvas, (int(at[0]), int(at[1])), round(self.radius * ZOOM * unit), 255, -1, cv2.LINE_AA, SHIFT)
        return np.asarray(cv2.resize(canvas, (side, side), interpolation=cv2.INTER_AREA), np.float32) / 255


class Person:
    """A body of swinging limbs with shoes and a racket."""

    def __init__(self, rng: np.random.Generator) -> None:
        """Draw one at random."""
        self.size = rng.uniform(30, 130)
        self.middle = np.array([WIDTH, HEIGHT]) * rng.uniform(0.05, 0.95, 2)
        self.velocity = rng.normal(0, 1, 2) * rng.choice([0.3, 2.5]) * self.size / 60
        self.levels = np.where(rng.random(8) < 0.3, rng.uniform(200, 255, 8), rng.uniform(5, 200, 8))
        # Of two arms and two legs, two parts each: angle, swing, rate and phase.
        self.swing = np.column_stack(
            [rng.uniform(-1.2, 1.2, 8), rng.exponential(0.7, 8), rng.uniform(0.1, 0.9, 8), rng.uniform(0, 6.3, 8)]
        )
        # Marks on the clothes: the shape, the share along it, offset across, size and level.
        self.marks = rng.uniform([0, 0, -0.5, 0.01, 0], [11, 1, 0.5, 0.06, 255], (30, 5))
        self.has_racket, self.has_shadow = rng.random(2) < [0.7, 0.5]

    def draw(self, image: ByteArray, mask: ByteArray | None, t: float, move: FloatArray) -> None:
        """Draw the person onto an image, and onto a mask, at a time."""
        s, at = self.size, self.middle + self.velocity * t
        right, down = np.array([s, 0.0]), np.array([0.0, s])
        angle = self.swing[:, 0] + self.swing[:, 1] * np.sin(self.swing[:, 2] * t + self.swing[:, 3])
        shapes: list[tuple[FloatArray, FloatArray, float, float]] = [
            (at, at + 0.3 * down, 0.2 * s, self.levels[0]),
            (at - 0.16 * down, at - 0.16 * down, 0.13 * s, self.levels[1]),
        ]
        for limb in range(4):
            root = at + (0.02 if limb < 2 else 0.32) * down
            spread = (0.0, 0.0, 0.4, -0.4)[limb]
            first, second = spread + angle[2 * limb], spread + angle[2 * limb] + angle[2 * limb + 1]
            knee = root + 0.22 * s * np.array([np.sin(first), np.cos(first)])
            end = knee + 0.22 * s * np.array([np.sin(second), np.cos(second)])
            shapes += [(root, knee, 0.08 * s, self.levels[2 + limb // 2]), (knee, end, 0.06 * s, self.levels[4])]
            if limb >= 2:
                shapes.append((end, end + 0.08 * right, 0.07 * s, self.levels[5]))
            elif limb == 0 and self.has_racket:
                ahead = np.array([np.sin(second), np.cos(second)])
                shapes.append((end, end + 0.25 * s * ahead, 1.0, self.levels[6]))
                shapes.append((end + 0.25 * s * ahead, end + 0.38 * s * ahead, -0.1 * s, self.levels[6]))
        starts, ends, thick, levels = (np.array(column) for column in zip(*shapes, strict=True))
        chosen, share, across = self.marks[:, 0].astype(int), self.marks[:, 1:2], self.marks[:, 2:3]
        spots = starts[chosen] + share * (ends - starts)[chosen] + across * thick[chosen, None] * [1, 0]
        pixels = np.concatenate([starts, ends, spots, [at + 0.1 * right + 0.75 * down]]) * move[0, 0] + move[:2, 2]
        points = [(int(x), int(y)) for x, y in pixels * 2**SHIFT]
        if self.has_shadow:
            part = image.copy()
            axes = (int(0.3 * s * 2**SHIFT), int(0.08 * s * 2**SHIFT))
            cv2.ellipse(part, points[-1], axes, 0, 0, 360, 20, -1, cv2.LINE_AA, SHIFT)
            cv2.addWeighted(part, 0.4, image, 0.6, 0, image)
        for k in range(len(shapes)):
            _draw_shape(image, points[k], points[k + len(shapes)], thick[k], levels[k])
            if mask is not None:
                _draw_shape(mask, points[k], points[k + len(shapes)], thick[k], 255.0)
        for point, size, level in zip(points[2 * len(shapes) :], self.marks[:, 3] * s, self.marks[:, 4], strict=False):
            _draw_shape(image, point, point, size, level)


def _draw_shape(canvas: ByteArray, a: tuple[int, int], b: tuple[int, int], thick: float, level: float) -> None:
    """Draw a limb, or (negative thickness) the outline of a racket's head, between two points in fixed point."""
    if thick < 0:
        axes = (int(-thick * 2**SHIFT * 1.3), int(-thick * 2**SHIFT))
        angle = float(np.degrees(np.arctan2(b[1] - a[1], b[0] - a[0])))
        cv2.ellipse(canvas, b, axes, angle, 0, 360, int(level), 1, cv2.LINE_AA, SHIFT)
    else:
        cv2.line(canvas, a, b, int(level), max(1, round(thick)), cv2.LINE_AA, SHIFT)


def _draw_people(
    ground: ByteArray, people: list[Person], in_front: np.ndarray, t: float, move: FloatArray
) -> tuple[ByteArray, ByteArray]:
    """Draw the people at a time; the image, and where they hide the object."""
    image, mask = ground.copy(), np.zeros_like(ground)
    for person, hides in zip(people, in_front, strict=True):
        person.draw(image, mask if hides else None, t, move)
    return image, mask


def _draw_background(rng: np.random.Generator, width: int, height: int) -> ByteArray:
    """Draw a still background: surfaces, lines, lettering, and a crowd."""
    surface = np.full((height, width), rng.uniform(15, 200), np.float32)
    for scale in (2, 6, 20, 80):
        grain = rng.normal(0, 1, (height // scale + 2, width // scale + 2)).astype(np.float32)
        grain = cv2.resize(grain, (width, height), interpolation=cv2.INTER_CUBIC)
        surface += grain * rng.exponential(2.0 if scale < 10 else 9.0)
    image = np.clip(surface, 0, 255).astype(np.uint8)
    for _ in range(rng.integers(0, 9)):
        x, y, w, h = rng.uniform(0, [width, height, width * 0.6, height * 0.4])
        cv2.rectangle(image, (int(x), int(y)), (int(x + w), int(y + h)), float(rng.uniform(0, 255)), -1, cv2.LINE_AA)
    if rng.random() < 0.5:
        top = int(rng.uniform(0.1, 0.6) * height)
        for _ in range(int(rng.uniform(100, 700))):
            x, y, r = rng.uniform(0, width), rng.uniform(0, top), rng.uniform(1, 7)
            level = rng.uniform(0, 255) if rng.random() < 0.4 else rng.uniform(0, 90)
            cv2.ellipse(image, (int(x), int(y)), (int(r), int(r * 1.4)), 0, 0, 360, float(level), -1, cv2.LINE_AA)
    for _ in range(rng.integers(0, 8)):
        a, b = rng.uniform(0, [width, height], (2, 2)).astype(int)
        level, thick = float(rng.uniform(150, 255)), int(rng.integers(1, 5))
        cv2.line(image, (int(a[0]), int(a[1])), (int(b[0]), int(b[1])), level, thick, cv2.LINE_AA)
    for _ in range(rng.integers(0, 7)):
        text = "".join(chr(c) for c in rng.integers(65, 91, rng.integers(2, 9)))
        where = (int(rng.uniform(0, width)), int(rng.uniform(0, height)))
        size, level, thick = float(rng.uniform(0.3, 2)), float(rng.uniform(0, 255)), int(rng.integers(1, 5))
        cv2.putText(image, text, where, 0, size, level, thick, cv2.LINE_AA)
    return image


def _random_board(rng: np.random.Generator) -> tuple[int, int, ByteArray, float, float] | None:
    """Draw a board whose content runs or changes, on some films."""
    if rng.random() > 0.4:
        return None
    content = _draw_background(rng, 600, int(rng.integers(12, 40)))
    x, y = int(rng.uniform(-100, WIDTH - 50)), int(rng.uniform(0, HEIGHT - 45))
    return x, y, content, float(rng.choice([0.0, rng.normal(0, 4)])), float(rng.uniform(-2, FRAMES + 6))


def _show_board(image: ByteArray, board: tuple[int, int, ByteArray, float, float] | None, k: int) -> None:
    """Show a board in frame k: it runs at its speed, and from its moment of change shows other content."""
    if board is None:
        return
    x, y, content, speed, change = board
    shown = np.roll(content if k < change else 255 - content, round(speed * k), axis=1)[:, :200]
    left, right = max(x, 0), min(x + 200, WIDTH)
    image[y : y + len(shown), left:right] = shown[: HEIGHT - y, left - x : right - x]


def _film(rng: np.random.Generator, frames: Float32Array) -> ByteArray:
    """Give frames (T, H, W) contrast, blur, sharpening, noise and compression."""
    gamma, gain = float(np.exp(rng.normal(0, 0.25))), float(np.exp(rng.normal(0, 0.15)))
    images = 255 * np.clip(frames / 255 * gain, 0, 1) ** gamma
    blur, halo = rng.uniform(0.3, 1.3), rng.exponential(0.5)
    noise = rng.exponential(1.5)
    out = []
    for image in images:
        image = cv2.GaussianBlur(image, (0, 0), blur)
        image = image + halo * (image - cv2.GaussianBlur(image, (0, 0), 1.2))
        grain = noise * rng.standard_normal(image.shape, np.float32)
        out.append(np.clip(image + grain, 0, 255).astype(np.uint8))
    draw = rng.random()
    if draw < 0.1:
        return np.stack(out)
    return _compress(out, str(int(rng.uniform(17, 37))), str(rng.choice(["ultrafast", "veryfast", "fast"])))


def _compress(images: list[ByteArray], crf: str, preset: str) -> ByteArray:
    """Code images in H.264 and decode them."""
    buffer = io.BytesIO()
    with av.open(buffer, "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=25, options={"crf": crf, "preset": preset, "threads": "1"})
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        for image in images:
            frame = av.VideoFrame(WIDTH, HEIGHT, "yuv420p")
            for plane, values in zip(frame.planes, (image, None, None), strict=True):
                rows = np.full((plane.height, plane.line_size), 128, np.uint8)
                if values is not None:
                    rows[:, :WIDTH] = values
                plane.update(rows.tobytes())
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    buffer.seek(0)
    with av.open(buffer) as container:
        return np.stack([frame.to_ndarray()[:HEIGHT] for frame in container.decode(video=0)])
