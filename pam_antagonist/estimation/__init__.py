"""The estimator and its consistency figures."""

from pam_antagonist.estimation.estimator import Counts, EstimateRun, Estimator, ModelRun, simulate_model
from pam_antagonist.estimation.filter import COUNTERS, ESTIMATE_DTYPE

__all__ = ["COUNTERS", "ESTIMATE_DTYPE", "Counts", "EstimateRun", "Estimator", "ModelRun", "simulate_model"]
