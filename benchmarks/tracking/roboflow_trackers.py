"""Trackers of roboflow's kit `trackers`, which runs in an environment of its own.

Ball centres become square boxes, because these trackers associate by the overlap of boxes. Balls in a break move by
many radii per frame, so that tight boxes never overlap: every tracker gets several sizes of box.
"""

from __future__ import annotations

import numpy as np

from benchmarks.support.rival_environment import RivalEnvironment

TRACKERS = ("SORT", "ByteTrack", "OC-SORT", "BoT-SORT")
# Half widths of the boxes, in ball radii. 1 and 10 give more switches.
BOX_HALF_WIDTHS = (3.0, 6.0)
ENVIRONMENT = RivalEnvironment("trackers", ("trackers==2.6.1",))


def track_in_environment(
    centre: np.ndarray, frame: np.ndarray, fps: float, radius: float
) -> dict[tuple[str, float], np.ndarray]:
    """Track detections with every tracker and size of box.

    Args:
        centre: (K, 2) px, in order of frames.
        frame: (K,) frame of each detection, from 0.
        fps: Frame rate.
        radius: Radius of a ball, px.

    Returns:
        Track (K,) of each detection by tracker and half width of the boxes in radii; -1 without a track.
    """
    arrays = {"centre": centre, "frame": frame, "fps": np.array(fps), "radius": np.array(radius)}
    results = ENVIRONMENT.call(track_boxes, arrays)
    return {(name, half): results[f"{name} {half}"] for name in TRACKERS for half in BOX_HALF_WIDTHS}


def track_boxes(centre: np.ndarray, frame: np.ndarray, fps: np.ndarray, radius: np.ndarray) -> dict[str, np.ndarray]:
    """Track with default options, in the environment of the rival; the camera stands still."""
    import supervision
    import trackers

    classes = {
        "SORT": trackers.SORTTracker,
        "ByteTrack": trackers.ByteTrackTracker,
        "OC-SORT": trackers.OCSORTTracker,
        "BoT-SORT": lambda **options: trackers.BoTSORTTracker(enable_cmc=False, **options),
    }
    results = {}
    for half in BOX_HALF_WIDTHS:
        boxes = np.hstack([centre - half * radius, centre + half * radius])
        for name in TRACKERS:
            tracker, track = classes[name](frame_rate=float(fps)), np.full(len(centre), -1)
            for number in range(int(frame.max()) + 1):
                rows = np.flatnonzero(frame == number)
                detections = supervision.Detections(
                    xyxy=boxes[rows], confidence=np.ones(len(rows)), class_id=np.zeros(len(rows), int),
                    data={"row": rows},
                )  # fmt: skip
                tracked = tracker.update(detections)
                track[tracked.data["row"]] = tracked.tracker_id
            results[f"{name} {half}"] = track
    return results
