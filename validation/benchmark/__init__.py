"""What the package costs: every figure a ratio, measured in one run beside what it is measured against."""
