"""The condition of a bag as JSON."""

from typing import Any

from pushfric_core.bags.bag import Bag


def condition(bag: Bag) -> dict[str, Any]:
    """Whether a bag is whole, and what is missing."""
    damage = bag.damage
    gaps = [] if damage is None else damage.gaps
    return {
        "whole": damage is None,
        "messages": bag.summary.message_count,
        "topics": {topic.name: topic.message_count for topic in bag.summary.topics},
        "missing": {} if damage is None else damage.missing,
        "gaps": [{"file": file.name, **gap._asdict()} for file, gap in gaps],
        "contradictions": [] if damage is None else list(damage.contradictions),
        "notes": list(bag.notes),
    }
