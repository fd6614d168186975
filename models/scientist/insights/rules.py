"""When another batch is worth it: numbers that the configuration and the advice share, and that import nothing."""

MARGIN = 0.05  # by which a batch must beat the best to be worth it, unless the lab says otherwise
LEAST_CHANCE = 0.1  # below it another batch is not worth its work
STOP_CHANCE, IN_A_ROW = 0.03, 2  # chance that so many batches in a row are below, when a campaign stops by itself
