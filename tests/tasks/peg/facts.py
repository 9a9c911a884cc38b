# ruff: noqa: F821  these lines go into protocol/tasks.py, in place of its table
@dataclass(frozen=True, kw_only=True)
class PegSpec(TabletopSpec):
    """Peg: the plate's side and height, and its least distance from the peg (m)."""

    plate_side: float
    plate_height: float
    apart: float


PEG = PegSpec(
    name="peg",
    revision=1,
    title="Peg",
    goal="peg on the plate",
    portrait=TABLETOP_PORTRAIT,
    workspace=PICK_UP.workspace,
    camera=PICK_UP.camera,
    arm=PICK_UP.arm,
    force_limit=PICK_UP.force_limit,
    object_can_leave=True,
    cube=CubeSpec(side=0.035, mass=0.2),
    plate_side=0.08,
    plate_height=0.01,
    apart=0.10,
)

TASK_SPECS: tuple[TaskSpec, ...] = (PLAYING, PUSHING, OPENING, PICK_UP, PEG)
