"""Gap discovery: where simulation and measurement disagree, which effect is missing, and how much of it that closes.

Its words, and where each lives:

- Data: grasps (`grasps`), a bank around them and what is held out (`data`); split once, passed down.
- Bank: the simulations around the grasps, with and without effects; Surrogate: what they say of every grasp (`bank`).
  The wide bank only proposes; where the bank that answers lies is chosen in `local_bank`.
- Fit: theta, tools, numerical error and effects calibrated together; its posterior (`fit`). It needs no naming.
- Where: phases, strata and tests of the residuals that a fit leaves (`where`).
- Candidate: an effect that was fitted and scored; Decision: what is named, if anything (`naming`).
- HeldOut: what was never looked at; the evaluation, the power and the next experiment (`evaluation`).
- Round: where, candidates and decision, once; Findings: all rounds, as written to `findings.json` (`findings`).
"""
