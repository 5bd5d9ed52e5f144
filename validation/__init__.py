"""What measures the product: the paper, the battery, speed and faults. Nothing in the product imports it."""
