"""Ours beside what others would use: soft sensors without physics, other filters, laws fitted to residuals."""
