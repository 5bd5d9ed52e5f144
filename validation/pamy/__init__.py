"""The measured arm: what ``close_loop`` makes of 2,400 episodes of a real joint, beside models without physics."""
