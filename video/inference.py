"""onnxruntime, told to keep to itself: where the environment does not say so before its import, release 1.32 reports to
its maker over the network that it runs."""

from __future__ import annotations

import os

os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")

import onnxruntime

__all__ = ["onnxruntime"]
