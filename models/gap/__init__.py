"""Gap discovery: where simulation and measurement disagree, which effect is missing, and how much of it that closes.

Its words, and where each lives:

- Data: grasps (`grasps`), a bank around them and what is held out (`data`); split once, passed down.
- Bank: the simulations around the grasps, with and without effects; Surrogate: what they say of every grasp (`bank`).
  The wide bank says whether anything is missing and proposes; where the bank that answers lies is chosen in
  `local_bank`.
- Fit: theta, tools, numerical error and effects calibrated together; its posterior (`fit`). It needs no naming.
- Where: phases, strata and tests of the residuals that a fit leaves (`where`).
- Evidence: how much more probable an effect, a pattern or a drift makes the data; Trial: an effect in the simulator,
  everything fitted again; Rehearsal: made-up worlds of the panel at hand (`evidence`).
- Decision: what is named, if anything (`naming`); the grasps and readings that are asked for next (`ask`).
- HeldOut: grasps that no parameter is fitted to; what the name changes on them (`evaluation`).
- Round: where, candidates and decision, once; Findings: all rounds, as written to `findings.json` (`findings`).
"""
