"""Local web page: identification, design of a joint, and runs. Needs the extra `web`."""

from importlib import resources


def resource(name: str) -> str:
    """Text of a file of this package."""
    return (resources.files(__name__) / name).read_text(encoding="utf-8")
