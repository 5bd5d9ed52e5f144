"""Reports of the commands: numbers, tables, figures and one self-contained page."""
