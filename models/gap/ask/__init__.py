"""Ask: which grasps would tell apart all that is still possible, and what their outcome says.

`forecast`: what hypotheses say of pairs of grasps, and how many nats apart that is. `choose`: the fewest pairs that
promise enough, by time. `settings`: what a bench can do otherwise. `hypotheses`: what is still possible after a round,
and what it predicts. `person`: what a person can measure where no grasp tells. `outcomes`: what outcomes mean.
`refine`: once a name is sure, the grasps for the parameter on which the ranking of designs hangs.
"""
