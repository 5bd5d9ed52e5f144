"""Commands. Each module has ``main(argv) -> int``, imports no more than it needs and leaves the work to others."""
