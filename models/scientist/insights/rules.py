"""When another batch is worth it: numbers that the configuration and the advice share, and that import nothing."""

MARGIN = 0.05  # by which a batch must beat the best to be worth it, unless the lab says otherwise
LEAST_CHANCE = 0.1  # below it another batch is not worth its work
IN_A_ROW = 2  # batches below it, after which a campaign stops by itself
