"""What callers from Python give."""


def check_is(kind: type, source: str, **given: object) -> None:
    """Raise `TypeError` with the argument's name unless each is of this kind, or None; `source` is what gives one."""
    for name, value in given.items():
        if value is not None and not isinstance(value, kind):
            raise TypeError(f"{name} is a {kind.__name__}, as {source} gives it. Got {value!r}.")
