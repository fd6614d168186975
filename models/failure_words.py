"""Why a simulation has failed: the words that rows of the lake keep, and how a person reads them."""

WORDS = {
    "arithmetic": "numbers got out of range",
    "crash": "the mesher ended in the middle of its work",
    "deep_penetration": "the finger would go too deep into the object",
    "empty": "the finger's outline gave no mesh",
    "hang": "no answer in time, so its process was ended",
    "indefinite": "the solver found no stable state",
    "inverted_element": "an element of the mesh turned inside out",
    "max_steps": "too many steps, the grasp does not settle",
    "no_convergence": "the solver found no balance of forces",
    "object_outside": "the object is out of the fingers' reach",
    "overlap_at_start": "the object touches the open fingers",
    "time_out": "longer than its time limit",
    "worker_died": "its process died each time, often for want of memory",
}


def spell_reason(reason: str) -> str:
    """A reason in words; one that is a sentence already, or of another version, as it is."""
    return WORDS.get(reason, reason)
