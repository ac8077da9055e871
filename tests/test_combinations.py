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


@pytest.mark.parametrize("forgets", [False, True])
def test_a_scene_that_is_not_the_same_is_found(forgets, monkeypatch):
    """A spring whose stiffness forgets the units of the world; it acts on the motion."""

    def band(made, random):
        return [parts.Band(*parts._two(made, random), 50.0 if forgets else made.world.of(50.0, "N/m"))]

    monkeypatch.setitem(parts.PARTS, "Band", band)
    recipe = scenes.Recipe(4, (("RigidBody", 1), ("RigidBody", 2)), (("Revolute", 3), ("Revolute", 4)), (("Band", 6),))
    found, why = outcome(Case(recipe), "units")
    assert (found, "of the way apart" in why) == (("failed", True) if forgets else ("passed", False))
