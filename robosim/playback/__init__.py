"""Recordings of runs, for the rerun viewer."""

from robosim.playback.recorder import Recorder, recording

__all__ = ["Recorder", "recording"]
