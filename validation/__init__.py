"""What measures the product: the paper, the battery, peers, speed and faults. Nothing in the product imports it."""
