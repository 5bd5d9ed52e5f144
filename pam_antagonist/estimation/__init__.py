"""The estimator and its consistency figures."""

from pam_antagonist.estimation.estimator import EstimateRun, Estimator
from pam_antagonist.estimation.memory import COUNTERS, ESTIMATE_DTYPE, Counts
from pam_antagonist.estimation.model_run import ModelRun, simulate_model

__all__ = ["COUNTERS", "ESTIMATE_DTYPE", "Counts", "EstimateRun", "Estimator", "ModelRun", "simulate_model"]
