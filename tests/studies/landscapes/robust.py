"""Campaigns that look for what nine of ten prints hold, beside campaigns that look for the force of the drawing."""

from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from fast.models.design.space import FIN_RAYS, random_unit, to_unit
from fast.models.scientist.acquisition.front import Criterion, draw_surrogate
from fast.models.scientist.copies import lose_in_copies
from fast.models.scientist.propose import NO_PENDING, Room, Rule, propose
from fast.models.scientist.surrogate.fit import fit_surrogate
from fast.models.scientist.surrogate.observations import REAL, SIM, ObservationSet
from fast.models.scientist.surrogate.posterior import Surrogate
from fast.models.simulation.tolerances import Tolerances
from tests.studies.benchmarks.base import Options, Tables
from tests.studies.landscapes.bank import BELIEVED, LandscapeBank
from tests.studies.landscapes.landscape import Force, Landscape, find_best, read_landscape

BANK = Path(__file__).resolve().parents[3] / "docs" / "benchmarks" / "landscapes.json"
WALL_SD_MM = Tolerances().wall_offset_mm
N_SIMULATED, N_FIRST, N_ROUNDS, N_BATCH = 100, 20, 4, 10
N_SEEDS, N_WORKERS = 3, 2
NOMINAL, ROBUST = "mean_peak_n", "robust_peak_n"


def measure_robust(options: Options) -> Tables:
    """What nine of ten prints hold of the finger that a campaign ends with, by its objective; --n seeds of each truth.

    Walls and ribs of a print are thicker alike, by 0.1 mm (one sd). `possible_share`: the same of the two best designs
    of the landscape, which no campaign knows.
    """
    truths = range(len(LandscapeBank.read(BANK).truths))
    jobs = [(number, seed) for number in truths for seed in range(options.n or N_SEEDS)]
    with ProcessPoolExecutor(options.workers or N_WORKERS, mp_context=get_context("spawn")) as pool:
        found = []
        for row in pool.map(_race, jobs):
            found.append(row)
            options.tell(f"{len(found)} of {len(jobs)} races: {row}")
    return {"what nine of ten prints hold": [_sum_up(number, found) for number in truths]}


def _sum_up(number: int, found: Sequence[dict[str, Any]]) -> dict[str, Any]:
    rows = [row for row in found if row["truth"] == number]
    nominal, robust = (np.array([row[name] for row in rows]) for name in (NOMINAL, ROBUST))
    return {
        "truth": number,
        "n_races": len(rows),
        "nominal_n": float(nominal.mean()),
        "robust_n": float(robust.mean()),
        "robust_over_nominal": float((robust / nominal).mean()),
        "n_at_least_as_good": int((robust >= nominal).sum()),
        "possible_share": rows[0]["possible"],
    }


def _race(job: tuple[int, int]) -> dict[str, Any]:
    """What nine of ten prints of the chosen fingers hold in truth, N, of both campaigns on the same first tools."""
    number, seed = job
    landscape = read_landscape(BANK, number)
    held = partial(_hold, landscape.real)
    starts = np.concatenate([LandscapeBank.read(BANK).believed.x, random_unit(5_000, np.random.default_rng(number))])
    nominal, robust = (find_best(force, starts, np.random.default_rng(number)) for force in (landscape.real, held))
    row = {"truth": number, "seed": seed, "possible": float(held(robust[None])[0] / held(nominal[None])[0])}
    return row | {name: float(held(_search(landscape, seed, name)[None])[0]) for name in (NOMINAL, ROBUST)}


def _hold(force: Force, x: np.ndarray) -> np.ndarray:
    """What nine of ten prints of designs (m x 9) hold, N."""
    truth = SimpleNamespace(mean=lambda x, s: force(x), data=SimpleNamespace(force_n=lambda y: y))
    return np.asarray(force(x) - lose_in_copies(truth, x, np.full(len(x), REAL), FIN_RAYS, WALL_SD_MM))  # type: ignore[arg-type]


def _search(landscape: Landscape, seed: int, objective: str) -> np.ndarray:
    """The measured design (9) that a campaign with this objective recommends."""
    first, rng = np.random.default_rng([seed, 0]), np.random.default_rng([seed, 1])
    simulated = random_unit(N_SIMULATED, first)
    x = random_unit(N_FIRST, first)
    y = landscape.measure(x, first)
    believed = landscape.simulators[BELIEVED](simulated)
    for number in range(N_ROUNDS + 1):
        s = np.repeat([SIM, REAL], [N_SIMULATED, len(y)])
        data = ObservationSet(np.concatenate([simulated, x]), s, np.concatenate([believed, y]), np.zeros(len(s)))
        forces = fit_surrogate(data.in_logs(), None)
        model = forces if objective == NOMINAL else _fit_robust(data, forces)
        if number == N_ROUNDS:
            break
        rule = Rule(criteria=[Criterion(draw_surrogate(model), model, is_objective=True)])
        chosen = propose(forces, REAL, N_BATCH, NO_PENDING, rng, rule, Room())
        new = to_unit([one.design for one in chosen])
        x, y = np.concatenate([x, new]), np.concatenate([y, landscape.measure(new, rng)])
    return np.asarray(x[np.argmax(model.mean(x, REAL))])


def _fit_robust(data: ObservationSet, forces: Surrogate) -> Surrogate:
    """The surrogate of what nine of ten prints hold, as a campaign makes it."""
    lost = lose_in_copies(forces, data.x, data.s, FIN_RAYS, WALL_SD_MM)
    return fit_surrogate(ObservationSet(data.x, data.s, data.y - lost, data.noise_variance).in_logs(), None)
