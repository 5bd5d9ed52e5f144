"""What can be wrong with the input, in one place and in one line."""

from __future__ import annotations


class BadInput(Exception):
    """Input that cannot be used: a file, topic, parameter or value.

    The message is one line that names what is wrong, where it stands and what was expected. Commands
    and nodes print it after ``error:`` and end with status 2.
    """
