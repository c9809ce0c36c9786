"""Page of runs."""


def page() -> None:
    """x."""
