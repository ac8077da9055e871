"""A fixed sample of random scenes (combinations.py), and seeds that have failed."""

import combinations_parts as parts
import combinations_scenes as scenes
import pytest
from combinations import CHECKS, Case, outcome

from polyida import registry

SEEDS = range(12)
SAMPLE = [(seed, kind) for seed in SEEDS for kind in CHECKS]


def test_every_part_takes_its_turn():
    """A part that is added to the registry is added to the generator."""
    drawn = {name.partition(",")[0] for name in (*scenes.BODIES, *scenes.LINKS, *scenes.PARTS)}
    built_in = {name for name, part in registry.parts.items() if isinstance(part, str)}
    assert built_in <= drawn


@pytest.mark.parametrize(("seed", "kind"), SAMPLE)
def test_it_holds_in_a_random_scene(seed, kind):
    found, why = outcome(Case(scenes.recipe(seed)), kind)
    assert found != "failed", why


def test_a_scene_that_is_not_the_same_is_found(monkeypatch):
    """A spring whose stiffness forgets the units of the world."""
    monkeypatch.setitem(parts.PARTS, "Band", lambda made, random: [parts.Band(*parts._two(made, random), 2000.0)])
    recipe = scenes.Recipe(1, (("RigidBody", 1), ("RigidBody", 2)), (("Revolute", 3), ("Revolute", 4)), (("Band", 5),))
    assert outcome(Case(recipe), "units")[0] == "failed"
