"""What a grasp that has just ended says: as the simulator has it or not, like its repeats or not."""

import statistics
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

BAND = 0.9  # share of the gaps so far that the band holds
LEAST_GAPS = 5  # before there is a band
FAR_SDS = 3.0  # of the repeats' spread; farther is not like them


@dataclass(frozen=True)
class Verdict:
    """A sentence, and whether the grasp is strange in either way."""

    sentence: str
    is_strange: bool


def judge_grasp(
    peak_force_n: float,
    simulated_n: float | None,
    gaps_n: Sequence[float],
    repeats_n: Sequence[float],
    repeat_sd_n: float | None,
) -> Verdict:
    """Judge the peak of a grasp, in N.

    `simulated_n`: what the simulator gives. `gaps_n`: measured minus simulated of other tools and objects; the band is
    what holds `BAND` of them about zero. `repeats_n`: peaks of the same grasp before; `repeat_sd_n`: the standard
    deviation of repeats, of all tools and objects.
    """
    words, is_strange = [f"{peak_force_n:.1f} N"], False
    if simulated_n is not None:
        gap_n = peak_force_n - simulated_n
        told = f"simulated {simulated_n:.1f} N"
        if len(gaps_n) >= LEAST_GAPS:
            half_n = float(np.quantile(np.abs(gaps_n), BAND))
            is_out = abs(gap_n) > half_n
            is_strange |= is_out
            told += f", {'outside' if is_out else 'inside'} the band of ±{half_n:.1f} N"
        words.append(told)
    if repeats_n:
        mean_n = statistics.fmean(repeats_n)
        listed = " and ".join(f"{each:.1f}" for each in repeats_n[-2:])
        if repeat_sd_n:
            limit_n = FAR_SDS * repeat_sd_n * (1.0 + 1.0 / len(repeats_n)) ** 0.5
            is_far = abs(peak_force_n - mean_n) > limit_n
            is_strange |= is_far
            words.append(f"{'not like' if is_far else 'like'} its repeats ({listed} N)")
        else:
            words.append(f"its repeats: {listed} N")
    return Verdict("; ".join(words), is_strange)
