"""The draws as an ArviZ file: NetCDF, read by `arviz.from_netcdf` and by anything that reads HDF5."""

import warnings
from pathlib import Path

import numpy as np

from models.calibration.inference.result import CalibrationResult
from models.calibration.means.problem import THETA, CalibrationProblem
from models.design.space import PARAMETERS
from models.units import unit_of


def write_archive(path: Path, result: CalibrationResult, calibration_id: str, data: CalibrationProblem | None) -> Path:
    """Write posterior draws, diagnostics as attributes, and, where known, the data as constant and observed data."""
    with warnings.catch_warnings():  # ArviZ announces its next version on import
        warnings.simplefilter("ignore", FutureWarning)
        import arviz
    posterior, dims, coords = _posterior(result)
    constant, observed = ({}, {}) if data is None else _data(data)
    archive = arviz.from_dict(
        posterior=posterior,
        constant_data=constant or None,
        observed_data=observed or None,
        dims=dims | {name: axes for name, axes in _DATA_DIMS.items() if name in constant | observed},
        coords=coords,
        posterior_attrs=_attributes(result, calibration_id),
    )
    for name, values in archive.posterior.data_vars.items():
        if unit := unit_of(str(name)):
            values.attrs["units"] = unit
    path.parent.mkdir(parents=True, exist_ok=True)
    path.unlink(missing_ok=True)  # a file that a reader still has open keeps its content
    archive.to_netcdf(str(path), engine="h5netcdf")
    return path


_DATA_DIMS = {
    "x_sim": ["simulation", "design_parameter"],
    "theta_sim": ["simulation", "theta_parameter"],
    "y_sim_n": ["simulation"],
    "variance_sim_n2": ["simulation"],
    "x_real": ["measurement", "design_parameter"],
    "y_real_n": ["measurement"],
    "variance_real_n2": ["measurement"],
}


def _posterior(
    result: CalibrationResult,
) -> tuple[dict[str, np.ndarray], dict[str, list[str]], dict[str, list[str]]]:
    """Variables (chains x n, or chains x n x inputs), their dimensions, and the names of the inputs."""
    variables: dict[str, np.ndarray] = {}
    dims: dict[str, list[str]] = {}
    coords = {"design_parameter": list(PARAMETERS), "theta_parameter": list(THETA)}
    for kernel in ("h", "e"):
        names = [name for name in result.names if name.startswith(f"lengthscale_{kernel}.")]
        if names:
            variables[f"lengthscale_{kernel}"] = np.stack([result.of(name) for name in names], axis=-1)
            dims[f"lengthscale_{kernel}"] = [f"input_{kernel}"]
            coords[f"input_{kernel}"] = [name.partition(".")[2] for name in names]
    variables |= {name: result.of(name) for name in result.names if "." not in name}
    return variables, dims, coords


def _data(data: CalibrationProblem) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    constant = {
        "x_sim": data.x_sim,
        "theta_sim": data.theta_sim,
        "variance_sim_n2": data.variance_sim,
        "x_real": data.x_real,
        "variance_real_n2": data.variance_real,
    }
    return constant, {"y_sim_n": data.y_sim, "y_real_n": data.y_real}


def _attributes(result: CalibrationResult, calibration_id: str) -> dict[str, str | float | int]:
    known: dict[str, str | float | int] = {
        "calibration_id": calibration_id,
        "method": result.method,
        "n_divergences": result.n_divergences,
        "k_hat": np.nan if result.k_hat is None else result.k_hat,
        "warnings": "\n".join(result.warnings),
        "settings": result.settings.model_dump_json(),
    }
    return {name: value for name, value in known.items() if value != ""}
