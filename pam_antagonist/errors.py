"""The exception for invalid input."""

from __future__ import annotations


class BadInput(Exception):
    """Input that cannot be used: a file, topic, parameter or value.

    The message is one line with the problem, its place and what was expected. Commands and nodes print it after
    ``error:`` and end with status 2.
    """


class NoResult(BadInput):
    """Input that can be read, but from which nothing comes out, such as a fit that diverges: status 1."""
