"""Fresh virtual rigs by which the identification from measured pressures is judged."""
