"""Pairs of links that a description says never touch: SRDF's disabled collisions, and pairs that a user names."""

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from pathlib import Path

Pairs = set[frozenset[str]]


def srdf_pairs(root: ET.Element, file: Path, links: Sequence[str]) -> Pairs:
    """Pairs of links whose collisions an SRDF disables.

    Raises:
        ValueError: If it is no SRDF, or one of another robot.
    """
    disabled = _named(root, "disable_collisions")
    for entry in root.findall("disable_default_collisions"):
        disabled |= {frozenset((entry.get("link", ""), other)) for other in links}
    disabled -= _named(root, "enable_collisions")
    if not disabled:
        raise ValueError(f"{file} disables no collisions. Give an SRDF, with <disable_collisions link1= link2= .../>.")
    if not any(pair <= {*links} for pair in disabled):
        raise ValueError(
            f"{file.name} disables collisions of {' and '.join(sorted(next(iter(disabled))))}, and of no pair of this "
            f"robot's links: {', '.join(links)}. Give this robot's SRDF."
        )
    return disabled


def _named(root: ET.Element, tag: str) -> Pairs:
    return {frozenset((entry.get("link1", ""), entry.get("link2", ""))) for entry in root.findall(tag)}


def named_pairs(ignore: Iterable[Sequence[str]], links: Sequence[str]) -> Pairs:
    """Pairs that a user names.

    Raises:
        ValueError: If one is no pair of links.
    """
    pairs = set()
    for pair in ignore:
        if len(pair) != 2 or pair[0] == pair[1]:
            raise ValueError(f"what is ignored are pairs of links, as in [[base,hand]]. Got {list(pair)}.")
        for link in pair:
            if link not in links:
                raise ValueError(f"there is no link {link!r} to be ignored. Links: {', '.join(links)}.")
        pairs.add(frozenset(pair))
    return pairs


def neighbours(joints: Iterable[ET.Element], shaped: set[str], beside: Iterable[str]) -> Pairs:
    """Pairs of a link beside the chain and one that is a single moving joint away, with no shapes between the two.

    They meet inside their joint, as neighbours in a chain do.

    Args:
        joints: All joints.
        shaped: Links that have collision shapes and are kept.
        beside: Of these, the links that are not on the chain.
    """
    ways: dict[str, list[tuple[str, bool]]] = {}
    for joint in joints:
        above, below = joint.find("parent").attrib["link"], joint.find("child").attrib["link"]
        for one, other in ((above, below), (below, above)):
            ways.setdefault(one, []).append((other, joint.get("type") != "fixed"))
    pairs = set()
    for first in beside:
        seen, ahead = {first}, [(first, 0)]
        while ahead:
            link, moved = ahead.pop()
            for other, moves in ways.get(link, []):
                if other in seen or moved + moves > 1:
                    continue
                seen.add(other)
                if other not in shaped:
                    ahead.append((other, moved + moves))
                elif moved + moves == 1:
                    pairs.add(frozenset((first, other)))
    return pairs
