"""What the configuration shares with advice and simpler fingers; it imports nothing."""

MARGIN = 0.05  # by which a batch must beat the best to be worth it, unless the lab says otherwise
LEAST_CHANCE = 0.1  # below it another batch is not worth its work
STOP_CHANCE, IN_A_ROW = 0.02, 2  # chance that so many batches in a row are below, when a campaign stops by itself
FEWEST_RIBS, LEAST_MATERIAL, MOST_TOLERANCE, NEAREST = "fewest ribs", "least material", "most tolerance", "nearest"
SIMPLER = (FEWEST_RIBS, LEAST_MATERIAL, MOST_TOLERANCE, NEAREST)  # by what a finger is simpler than the best one
