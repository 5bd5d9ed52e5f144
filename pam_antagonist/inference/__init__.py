"""Common parts of identification and diagnosis: experiments, free parameters, likelihood, fits and profiles."""
