"""Recordings once more through the estimator that runs live, and through the model alone."""

from pam_antagonist.replays.result import ModelTrack, Replay, ReplayReport
from pam_antagonist.replays.run import after, replay

__all__ = ["ModelTrack", "Replay", "ReplayReport", "after", "replay"]
