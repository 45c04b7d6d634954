"""One of every kind of structure, for the properties that all must have."""

from itertools import combinations_with_replacement

import numpy as np

from structures import Structure, beams, chains, plates
from structures._elements.members import Material, Section

UNIT = {"length": 1.0, "EI": 1.0, "mass_per_length": 1.0}
ALLOY = Material(E=70e9, rho=2700.0, nu=0.3)
# a plate with rigidity D = 1 and mass per area 1
PLAIN = Material(E=12 * (1 - 0.3**2) / 0.1**3, rho=1.0 / 0.1, nu=0.3)
SQUARE = {"lengths": (1.0, 1.0), "thickness": 0.1, "material": PLAIN}
MIXES = sorted(combinations_with_replacement(("clamped", "free", "guided", "pinned"), 2))

EVERY = {
    **{f"beam {a}-{b}": lambda a=a, b=b: beams.beam(left=a, right=b, elements=7, **UNIT) for a, b in MIXES},
    "beam tension": lambda: beams.simply_supported(elements=9, tension=30.0, **UNIT),
    "beam varying tension": lambda: beams.cantilever(elements=9, tension=lambda x: 40 * (1 - x), **UNIT),
    "beam steel": lambda: beams.cantilever(
        length=1.2, section=Section.rectangle(0.05, 0.01), material=beams.materials.steel, elements=8
    ),
    **{
        f"plate {e}": lambda e=e: plates.plate(
            lengths=(0.5, 0.4), thickness=3e-3, material=ALLOY, elements=(4, 3), edges=e
        )
        for e in ("SSSS", "CCCC", "FFFF", "CFFF", "SFSF", "SCFS", "FSFC")
    },
    "plate prestress": lambda: plates.plate(
        lengths=(0.5, 0.4), thickness=3e-3, material=ALLOY, elements=(4, 3), prestress=(1e4, 2e3)
    ),
    "chain fixed-free": lambda: chains.chain(masses=[1.0, 2.0, 3.0], springs=[10.0, 20.0, 30.0], dashpots=0.1),
    "chain fixed-fixed": lambda: chains.chain(masses=[1.0, 2.0], springs=5.0, right="fixed"),
    "chain free-free": lambda: chains.chain(masses=[1.0, 2.0, 1.0], springs=5.0, left="free"),
    "shear building": lambda: chains.shear_building(masses=np.full(5, 1e5), stiffnesses=2e8),
    "oscillator": lambda: chains.oscillator(mass=2.0, stiffness=50.0, dashpot=0.3),
    "user": lambda: Structure.from_matrices([[2.0, -1.0], [-1.0, 1.0]], np.eye(2), dofs=["1+X", "2+X"]),
}
MASS = {
    "beam steel": 7850 * 0.05 * 0.01 * 1.2,
    "chain fixed-free": 6.0,
    "chain fixed-fixed": 3.0,
    "chain free-free": 4.0,
}
MASS |= {"shear building": 5e5, "oscillator": 2.0, "user": 2.0}
MASS |= {name: 1.0 for name in EVERY if name.startswith("beam") and name not in MASS}
MASS |= {name: 2700 * 3e-3 * 0.2 for name in EVERY if name.startswith("plate")}
