"""Fit the surrogate before a decision, or take the last fit again; fits go to the lake."""

import json
import logging
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

import numpy as np

from fast.lake.tables.campaign import FitRow
from fast.models.blas import one_blas_thread
from fast.models.errors import UsageError
from fast.models.ids import canonical_json, content_id
from fast.models.scientist.insights.health import surrogate_cards
from fast.models.scientist.object_surrogate import ObjectsSurrogate, fit_objects
from fast.models.scientist.objectives import Outcome
from fast.models.scientist.surrogate.fit import fit_surrogate, trust_prior, trust_simulations
from fast.models.scientist.surrogate.health import health_of
from fast.models.scientist.surrogate.observations import MIN_OBSERVATIONS, REAL, ObjectValues, ObservationSet
from fast.models.scientist.surrogate.parameters import PriorLink, SurrogateParameters
from fast.models.scientist.surrogate.posterior import Surrogate
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.settings import LOG

logger = logging.getLogger(__name__)

# How much the simulated designs must grow before simulations are chosen with fresh hyperparameters
REFIT_LEAST, REFIT_SHARE = 5, 0.05


def fit(campaign: Campaign, batch: int, data: ObservationSet, rows: Sequence[str]) -> Surrogate:
    """Fit the surrogate to all data before a batch is chosen, and record the fit with its health.

    `rows` are the ids of the grasps and simulations behind `data`.
    """
    seed = campaign.seed("fit", batch)
    surrogate = fit_surrogate(in_units_of(campaign, data), None, seed=seed)
    trusted = chosen = trust_prior(surrogate, seed)
    if surrogate.data.is_log:
        chosen = trust_simulations(trusted, seed)
    row = _fit_row(campaign, tools_fit_id(campaign, batch, data), batch, chosen, seed, "tools")
    campaign.lake.append([_with_health(row, surrogate)], campaign.provenance(seed, rows))
    if trusted is not surrogate:
        words = "prior campaigns are left aside for the choice of tools: measured tools are predicted better without"
        logger.warning("%s, before B%02d: %s", campaign.campaign_id, batch, words)
    if chosen is not trusted:
        words = "simulations are left aside for the choice of tools: measured tools are predicted better without them"
        logger.warning("%s, before B%02d: %s", campaign.campaign_id, batch, words)
    return chosen


def fit_outcome(campaign: Campaign, batch: int, outcome: Outcome, data: ObservationSet) -> Surrogate:
    """Fit another surrogate of another mean over the objects before a batch is chosen, and record it with its health.

    Raises:
        UsageError: the grasps do not have it.
    """
    _check_enough(outcome, data.n_real)
    seed = campaign.seed("fit", batch, outcome.name)
    surrogate = fit_surrogate(in_units_of(campaign, data), None, seed=seed)
    row = _outcome_row(campaign, batch, surrogate, seed, outcome.name)
    campaign.lake.append([_with_health(row, surrogate)], campaign.provenance(seed))
    return surrogate


def fit_outcome_by_object(campaign: Campaign, batch: int, outcome: Outcome, known: ObjectValues) -> ObjectsSurrogate:
    """Fit a surrogate of an outcome that one of the objects decides, and record those of its components.

    Raises:
        UsageError: the grasps do not have it.
    """
    _check_enough(outcome, int(np.count_nonzero(known.s == REAL)))
    seed = campaign.seed("fit", batch, outcome.name)
    objects = fit_objects(known, outcome.of_all, seed)
    rows = [
        _outcome_row(campaign, batch, part, seed, f"{outcome.name}, component {number}")
        for number, part in enumerate(objects.parts, start=1)
    ]
    campaign.lake.append(rows, campaign.provenance(seed))
    return objects


def _check_enough(outcome: Outcome, n: int) -> None:
    if n >= MIN_OBSERVATIONS:
        return
    if outcome.is_simulated:
        raise UsageError(
            f"the objective or limit `{outcome.name}` needs at least {MIN_OBSERVATIONS} designs that are simulated on "
            f"every object with their pressures, there are {n} (simulations of earlier versions of FAST and imported "
            "ones have none); take it out of the config, or start a new campaign."
        )
    raise UsageError(
        f"the objective or limit `{outcome.name}` needs {outcome.column} of at least {MIN_OBSERVATIONS} measured "
        f"tools, there are {n} (peaks that were told without samples have no work); take it out of the config, or tell "
        "traces."
    )


def _outcome_row(campaign: Campaign, batch: int, surrogate: Surrogate, seed: int, outcome: str) -> FitRow:
    data = surrogate.data
    fit_id = content_id("F", [campaign.campaign_id, batch, data.n_real, data.n_sim, outcome])
    return _fit_row(campaign, fit_id, batch, surrogate, seed, "tools").model_copy(update={"outcome": outcome})


def in_units_of(campaign: Campaign, data: ObservationSet) -> ObservationSet:
    """Return the observations as the campaign's surrogate takes them: forces, or their logarithms."""
    return data.in_logs() if campaign.config.scientist.surrogate == LOG else data


def surrogate_for_simulation(
    campaign: Campaign, batch: int, index: int, data: ObservationSet, rows: Callable[[], Sequence[str]]
) -> tuple[Surrogate, str]:
    """Return the surrogate that the next simulation is chosen with, and the id of its fit.

    The last fit of the batch, conditioned on all data, while these have grown little; then a new fit, recorded, that
    starts from the last. Which it is depends on the lake alone, so that a restart changes no proposal.
    """
    data = in_units_of(campaign, data)
    last = _last_fit(campaign, batch)
    if last is not None and not _is_outgrown(last, data):
        return fitted_before(last, data), last["fit_id"]
    seed = campaign.seed("simulation fit", batch)
    surrogate = trust_prior(fit_surrogate(data, _parameters(last) if last else None, seed=seed), seed)
    fit_id = content_id("F", [campaign.campaign_id, batch, "simulation", index])
    row = _fit_row(campaign, fit_id, batch, surrogate, seed, "simulations")
    campaign.lake.append([row], campaign.provenance(seed, rows()))
    return surrogate, fit_id


def fitted_before(row: Mapping[str, Any], data: ObservationSet) -> Surrogate:
    """Return the surrogate of a row of `fits`, conditioned on `data`; prior campaigns it left aside stay so."""
    parameters = _parameters(row)
    with one_blas_thread():
        return Surrogate.condition(data if parameters.priors else data.of_this_campaign(), parameters)


def _last_fit(campaign: Campaign, batch: int) -> dict[str, Any] | None:
    fits = campaign.lake.records(FitRow, campaign_id=campaign.campaign_id, batch=batch, purpose="simulations")
    last = max(fits, key=lambda row: (row.n_real, row.n_sim), default=None)
    return None if last is None else last.model_dump()


def _is_outgrown(last: Mapping[str, Any], data: ObservationSet) -> bool:
    """Return whether the data have grown so much since a fit that hyperparameters are worth fitting again."""
    least = last["n_sim"] + max(REFIT_LEAST, REFIT_SHARE * last["n_sim"])
    return bool(data.n_real != last["n_real"] or data.n_sim >= least)


def _parameters(row: Mapping[str, Any]) -> SurrogateParameters:
    return SurrogateParameters(
        rho=row["rho"],
        lengthscales_h=tuple(row["lengthscales_h"]),
        lengthscales_e=tuple(row["lengthscales_e"]),
        sd_h=row["sd_h"],
        sd_e=row["sd_e"],
        noise_sd=row["noise_sd_n"],
        nugget=row["nugget_n"],
        mean_sim=row["mean_sim_n"],
        mean_real=row["mean_real_n"],
        priors=tuple(
            PriorLink(**{key: link[key] for key in PriorLink.model_fields})
            for link in json.loads(row["priors_json"] or "[]")
        ),
    )


def tools_fit_id(campaign: Campaign, batch: int, data: ObservationSet) -> str:
    """Return the id of the fit that the tools of a batch are chosen with."""
    return content_id("F", [campaign.campaign_id, batch, data.n_real, data.n_sim])


def _fit_row(
    campaign: Campaign,
    fit_id: str,
    batch: int,
    surrogate: Surrogate,
    seed: int,
    purpose: Literal["tools", "simulations"],
) -> FitRow:
    parameters, data = surrogate.parameters, surrogate.data
    return FitRow(
        fit_id=fit_id,
        campaign_id=campaign.campaign_id,
        batch=batch,
        n_real=data.n_real,
        n_sim=data.n_sim,
        rho=parameters.rho,
        noise_sd_n=parameters.noise_sd,
        log_posterior=float(surrogate.log_posterior or 0.0),
        lengthscales_h=parameters.lengthscales_h,
        lengthscales_e=parameters.lengthscales_e,
        sd_h=parameters.sd_h,
        sd_e=parameters.sd_e,
        seed=seed,
        purpose=purpose,
        nugget_n=parameters.nugget,
        mean_sim_n=parameters.mean_sim,
        mean_real_n=parameters.mean_real,
        is_log=data.is_log,
        n_prior=data.n_prior,
        priors_json=canonical_json([link.model_dump() for link in parameters.priors]),
    )


def _with_health(row: FitRow, surrogate: Surrogate) -> FitRow:
    health = health_of(surrogate)
    for card in surrogate_cards(health, row.campaign_id):
        if card.tone != "green":
            logger.warning("%s, before B%02d: %s %s", row.campaign_id, row.batch, card.sentence, card.next_step)
    return row.model_copy(
        update=health.model_dump(include=set(FitRow.model_fields) - {"n_real", "n_sim", "n_prior", "rho"})
    )
