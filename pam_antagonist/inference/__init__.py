"""What identification and diagnosis share: experiments, free parameters, likelihood, fits and profiles."""
