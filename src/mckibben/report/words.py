"""Words of the report that are not numbers: its sections, and what the paper leaves open."""

SECTIONS = {
    "identification": "Muscle: test, identification, validation",
    "joint": "Knee: what it can hold",
    "tracking": "Control of position and stiffness",
}
