"""Meshes and elements of the mesh study: which cases at how many cells through the thickness."""

MEMBERS = (("polygons", "wachspress"), ("quads", "wachspress"), ("triangles", "wachspress"), ("polygons", "virtual"), ("quads", "virtual"))
POLYGONS, QUADS = MEMBERS[:1], MEMBERS[1:2]
QUADRATIC = (("polygons", "quadratic"), ("quads", "quadratic"))  # with half as many cells through the thickness
MOVING = {  # polygons of a plate in motion
    "swing": {"wachspress": (40, 160, 500, 1000), "virtual": (40, 160, 500, 1000), "quadratic": (10, 20, 30, 80, 160)},
    "motor": {"wachspress": (40, 160, 640, 2560), "virtual": (40, 160, 640, 2560), "quadratic": (10, 20, 40, 160)},
}
SLENDER = 200  # L / h of an elastica whose shear is 16 times less than at 50

QUICK = {
    "elastica": (2, 4, 8),
    "slender elastica": {QUADS: (2,)},
    "cantilever": (2, 4, 8),
    "csm1": (2, 4, 8),
    "csm1 polygons": (16,),
    "csm1 fine": (16, 40),
    "frequencies": (2, 4),
    "compliance": (2, 4, 8),
    "spin-up": ((130, 1, 1e-2), (130, 2, 5e-3)),
}
FULL = {
    "elastica": (2, 3, 4, 6, 8, 12),
    "slender elastica": {QUADS: (2, 4), POLYGONS: (2, 4, 6)},
    "cantilever": (2, 3, 5, 10, 20),
    "csm1": (2, 4, 8, 16),
    "csm1 polygons": (24, 32, 40),
    "csm1 fine": (24, 40),
    "frequencies": (2, 3, 4, 6, 8),
    "compliance": (2, 4, 8, 16, 32),
    "spin-up": ((65, 1, 1e-2), (130, 1, 1e-2), (130, 2, 5e-3), (260, 2, 5e-3), (260, 2, 2e-3)),
}


def tasks(quick):
    """The tasks of the study, dictionaries of plain values: all meshes, or with quick those that take seconds."""
    sizes = QUICK if quick else FULL
    loads = [{"load": load, "slenderness": 50} for load in (1, 10)]
    clamps = [{"clamp": clamp} for clamp in ("arc", "straight")]
    selection = grid("elastica", MEMBERS, sizes["elastica"], loads) + grid("csm1", MEMBERS, sizes["csm1"], clamps)
    for members, through in sizes["slender elastica"].items():
        selection += grid("elastica", members, through, [load | {"slenderness": SLENDER} for load in loads])
    selection += grid("csm1", POLYGONS, sizes["csm1 polygons"], clamps[:1])
    selection += grid("csm1", QUADS, sizes["csm1 fine"][:1], clamps)
    selection += grid("csm1", QUADS, sizes["csm1 fine"][1:], clamps[:1] if quick else clamps)
    selection += grid("cantilever", MEMBERS, sizes["cantilever"]) + grid("frequencies", MEMBERS, sizes["frequencies"])
    selection += grid("compliance", POLYGONS, sizes["compliance"], [{"at": at} for at in ("node", "section")])
    for case in ("elastica", "cantilever", "csm1", "frequencies"):
        halves = sorted({n // 2 for n in sizes[case]} - {0})[: 3 if quick else 5]
        selection += grid(case, QUADRATIC, halves, {"elastica": loads, "csm1": clamps}.get(case, ({},)))
    for case, elements in MOVING.items():
        selection += [
            {"case": case, "kind": "polygons", "element": element, "through": 0, "cells": count}
            for element, cells in elements.items()
            for count in (cells[:-1] if quick and element != "quadratic" else cells)
        ]
    return selection + [grid("spin-up", QUADS, (ny,), [{"nx": nx, "h": h}])[0] for nx, ny, h in sizes["spin-up"]]


def grid(case, members, sizes, options=({},)):
    """All combinations as tasks."""
    return [
        {"case": case, "kind": kind, "element": element, "through": n} | option
        for option in options
        for kind, element in members
        for n in sizes
    ]
