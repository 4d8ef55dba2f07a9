"""The guidance of an entry that brings a policy of our type and no guidance of its own."""

from policies.guidance import Guidance


class Unguided(Guidance):
    """Leaves the policy as it is, whatever it is made with."""

    def __init__(self, *_: object) -> None:
        pass
