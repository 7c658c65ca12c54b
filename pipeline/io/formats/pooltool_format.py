"""Systems of pooltool (Kiefl 2024, doi:10.21105/joss.07301), as `System.save` writes them: JSON or MessagePack.

pooltool's x runs along the width and its y along the length, seen from above counter-clockwise; ours exchange them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgpack
import numpy as np

from models.core.errors import OptionError
from models.core.scene import Table
from models.core.typing import FloatArray
from pipeline.io.formats.track_format import (
    MalformedTracks,
    PointTracks,
    Provenance,
    TrackFormat,
    read_document,
    write_document,
)
from pipeline.io.run_folder import parse_table

# Motion states of pooltool.
_ROLLING, _STATIONARY, _POCKETED = 3, 0, 4
# Height of a nose, ball radii; no path of a ball depends on it here.
_CUSHION_HEIGHT = 1.28


def recognises(path: Path, head: bytes) -> bool:
    """Return whether it is a system: its first keys are cue and table."""
    start = head[:4096]
    return path.suffix.lower() == ".msgpack" or (b'"cue"' in start and b'"cue_ball_id"' in start)


def read(path: Path) -> PointTracks:
    """Read the continuous histories of the balls, or the states at events where there are none."""
    packed = path.suffix.lower() == ".msgpack"
    document = msgpack.unpackb(path.read_bytes(), object_hook=_decode_array) if packed else read_document(path)
    parts = []
    for name, ball in document["balls"].items():
        rvw, state, t = max(
            (_list_states(ball[key]) for key in ("history_cts", "history")), key=lambda one: len(one[2])
        )
        if not len(t):
            rvw, state, t = _list_states({"states": [ball["state"]]})
        on_table = (state != _POCKETED) & np.isfinite(rvw[:, 0, :2]).all(axis=1)
        parts.append((np.full(int(on_table.sum()), name), t[on_table], rvw[on_table]))
    ids, t, rvw = (np.concatenate([part[k] for part in parts]) for k in range(3))
    times, frame = np.unique(t, return_inverse=True)
    steps = np.diff(times)
    fps = float(1 / np.median(steps)) if len(steps) else None
    columns = {
        "frame": frame, "t": t, "id": ids, "x": rvw[:, 0, 1], "y": rvw[:, 0, 0], "vx": rvw[:, 1, 1], "vy": rvw[:, 1, 0],
    }  # fmt: skip
    return PointTracks(columns, "m", fps, scene=_describe_table(document))


def _list_states(history: Any) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return positions, velocities and spins (T, 3, 3), motion states (T,) and times (T,), s."""
    if isinstance(history, dict):
        states = history["states"]
        history = [[state[key] for state in states] for key in ("rvw", "s", "t")]
    rvw, state, t = (np.asarray([] if one is None else one, np.float64) for one in (history or [None] * 3))
    return rvw.reshape(-1, 3, 3), state, t


def _describe_table(document: dict[str, Any]) -> dict[str, Any]:
    """Return the scene.json of a system."""
    lines = document["table"]["cushion_segments"]["linear"]
    width, length = (float(np.ravel(lines[a]["p1"])[k] - np.ravel(lines[b]["p1"])[k])
                     for a, b, k in (("12", "3", 0), ("9", "18", 1)))  # fmt: skip
    radius = float(next(iter(document["balls"].values()))["params"]["R"])
    return {"scene": "billiards", "units": "m", "table": {"length": length, "width": width}, "ball_radius": radius}


def _decode_array(value: dict[Any, Any]) -> Any:
    """Decode an array as msgpack-numpy packs it; objects, which it would unpickle, are refused."""
    plain = {key.decode() if isinstance(key, bytes) else key: entry for key, entry in value.items()}
    if "nd" not in plain or "data" not in plain:
        return value
    if plain.get("kind") in (b"O", "O"):
        raise MalformedTracks("it holds Python objects, which are not loaded")
    array = np.frombuffer(plain["data"], np.dtype(plain["type"]))
    return array.reshape(plain["shape"]) if plain["nd"] else array[0]


def _encode_array(value: Any) -> Any:
    array = np.asarray(value)
    return {b"nd": True, b"type": array.dtype.str, b"kind": b"", b"shape": array.shape, b"data": array.tobytes()}


def write(tracks: PointTracks, path: Path, provenance: Provenance) -> None:
    """Write a system on a table without pockets; velocities that are not known follow from the positions."""
    if not isinstance(tracks.scene.get("table"), dict):
        raise OptionError("A system of pooltool needs the table; write its length and width into scene.json of INPUT")
    table, packed = parse_table(dict(tracks.scene)), ".msgpack" in path.name
    xy, times = tracks.locate_metres(), tracks.list_times()
    balls = {}
    for name in tracks.ids:
        rows = np.flatnonzero(tracks.columns["id"] == name)
        rows = rows[np.argsort(times[rows], kind="stable")]
        balls[name] = _build_ball(name, table, times[rows], _build_states(tracks, xy, times, rows, table), packed)
    document = {
        "cue": {"cue_ball_id": "cue" if "cue" in balls else tracks.ids[0]}, "table": _build_table(table),
        "balls": balls, "t": float(times.max()), "events": [], "trueroll": dict(provenance),
    }  # fmt: skip
    if packed:
        path.write_bytes(msgpack.packb(document, default=_encode_array))
    else:
        write_document(document, path)


def _build_states(
    tracks: PointTracks, xy: FloatArray, times: FloatArray, rows: np.ndarray, table: Table
) -> tuple[FloatArray, FloatArray]:
    """Return positions, velocities and spins (T, 3, 3) in pooltool's axes, and motion states (T,)."""
    rvw = np.zeros((len(rows), 3, 3))
    rvw[:, 0, :2], rvw[:, 0, 2] = xy[rows][:, ::-1], table.ball_radius
    if {"vx", "vy"} <= tracks.columns.keys():
        rvw[:, 1, :2] = np.stack([tracks.columns["vy"][rows], tracks.columns["vx"][rows]], axis=1)
    elif len(rows) > 1:
        rvw[:, 1, :2] = np.gradient(rvw[:, 0, :2], times[rows], axis=0)
    return rvw, np.where(np.any(rvw[:, 1] != 0, axis=1), float(_ROLLING), float(_STATIONARY))


def _build_ball(
    name: str, table: Table, t: FloatArray, states: tuple[FloatArray, FloatArray], packed: bool
) -> dict[str, Any]:
    rvw, motion = states

    def build_state(k: int) -> dict[str, Any]:
        return {"rvw": rvw[k] if packed else rvw[k].tolist(), "s": int(motion[k]), "t": float(t[k])}

    def build_history(rows: list[int]) -> Any:
        return [rvw[rows], motion[rows], t[rows]] if packed else {"states": [build_state(k) for k in rows]}

    params = {"m": table.ball_mass, "R": table.ball_radius}
    ends = sorted({0, len(t) - 1})
    return {"id": name, "state": build_state(len(t) - 1), "params": params, "history": build_history(ends),
            "history_cts": build_history(list(range(len(t))))}  # fmt: skip


def _build_table(table: Table) -> dict[str, Any]:
    """Build a table of four cushions, numbered as in pooltool; its directions say on which side a ball may be."""
    w, l, h = table.width, table.length, _CUSHION_HEIGHT * table.ball_radius  # noqa: E741
    lines = {"3": ((0, 0), (0, l), 1), "12": ((w, l), (w, 0), 0), "9": ((0, l), (w, l), 0), "18": ((0, 0), (w, 0), 1)}
    linear = {
        name: {"id": name, "p1": [float(a[0]), float(a[1]), h], "p2": [float(b[0]), float(b[1]), h], "direction": side}
        for name, (a, b, side) in lines.items()
    }
    return {"cushion_segments": {"linear": linear, "circular": {}}, "pockets": {}, "table_type": "billiard"}


POOLTOOL = TrackFormat("pooltool", "pooltool system", (".pooltool.json", ".msgpack"), recognises, read, write, True)
