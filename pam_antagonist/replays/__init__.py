"""Replays: a recording is run through the live estimator, and through the model alone."""

from pam_antagonist.replays.result import ModelTrack, Replay, ReplayReport
from pam_antagonist.replays.run import after, replay

__all__ = ["ModelTrack", "Replay", "ReplayReport", "after", "replay"]
