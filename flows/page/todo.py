"""The inbox: everything that the lake's campaigns and searches ask of a person, derived from the lake."""

from dataclasses import dataclass
from pathlib import Path

from fast.flows.campaign.batch_folder import bench_folder, is_told, plan_batch
from fast.flows.campaign.status import read_campaign
from fast.flows.page.now import draw_path
from fast.lake.handoff.plan_folder import RESULTS, SHEET
from fast.lake.store import Lake
from fast.lake.tables.campaign import CampaignRow
from fast.lake.tables.imported import is_imported
from fast.models.design.reference import find_reference
from fast.models.errors import FastError, UsageError
from fast.models.gap.ask.person import find_measurement
from fast.models.gap.findings import PersonQuestion
from fast.models.ids import tool_label
from fast.models.records import Design
from fast.tasks.bench.asked import read_mounting, read_open_requests
from fast.tasks.bench.mount import plan_rack
from fast.tasks.bench.print import open_slots, print_folder
from fast.tasks.bench.questions import OpenQuestion, list_open_questions
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.simulator_versions import at_present
from fast.tasks.campaign.state import CampaignState
from fast.tasks.gap.findings import find_newest_run
from fast.tasks.gap.readings import is_answered


@dataclass(frozen=True)
class PrintSlot:
    """A tool that is to be printed: its drawing, and its walls as drawn."""

    slot: int
    label: str
    path: str
    height_mm: float
    length_mm: float
    walls: str
    is_reference: bool


@dataclass(frozen=True)
class PrintTodo:
    """A batch to be printed and mounted. `sheet`: below the lake's outputs; empty where it is not written yet."""

    campaign_id: str
    batch: int
    slots: tuple[PrintSlot, ...]
    sheet: str

    @property
    def name(self) -> str:
        """As people say it."""
        return f"{self.campaign_id}/B{self.batch:02d}"


@dataclass(frozen=True)
class MountTodo:
    """Kept tools that a search wants on the rack again; `slots` by tool."""

    campaign_id: str
    search_id: str
    slots: dict[str, int]
    sentence: str


@dataclass(frozen=True)
class ReadingTodo:
    """A number that a search asks a person for."""

    campaign_id: str
    search_id: str
    question: PersonQuestion
    instruction: str


@dataclass(frozen=True)
class ToldTodo:
    """Grasps that a bench of one's own is to make. `batch`: None where a search asks."""

    campaign_id: str
    batch: int | None
    n_left: int
    table: str
    sheet: str

    @property
    def name(self) -> str:
        """As people say it."""
        return f"{self.campaign_id}/B{self.batch:02d}" if self.batch is not None else f"{self.campaign_id}, a search"


@dataclass(frozen=True)
class BenchTodo:
    """Something that a campaign's bench asks, and waits for."""

    campaign_id: str
    asked: OpenQuestion


Todo = BenchTodo | PrintTodo | MountTodo | ReadingTodo | ToldTodo


def list_campaigns(lake: Lake) -> list[str]:
    """List campaigns that can be asked for something, newest first; imported ones ask for nothing."""
    rows = lake.rows(CampaignRow)
    names = [row["campaign_id"] for row in rows if not is_imported(row["config_toml"])]
    return list(dict.fromkeys(reversed(names)))


def read_todos(lake: Lake) -> list[Todo]:
    """Read what is asked for now, in all campaigns of the lake; one that cannot be read asks for nothing."""
    todos: list[Todo] = []
    for campaign_id in list_campaigns(lake):
        try:
            campaign = at_present(read_campaign(lake, campaign_id))
            todos += [BenchTodo(campaign_id, asked) for asked in list_open_questions(lake, campaign_id)]
            todos += _of_campaign(campaign, campaign.state())
        except FastError:  # of an older program, or its files are gone: its own commands say what is wrong
            continue
    todos += _of_search(lake, None, None)
    return todos


def _of_campaign(campaign: Campaign, state: CampaignState) -> list[Todo]:
    batches = sorted({tool.batch for tool in state.tools if tool.batch not in state.imported})
    if campaign.config.bench.is_folder:
        told = [_tell_batch(campaign, state, batch) for batch in batches if not is_told(campaign, state, batch)]
        return [*told, *_of_search(campaign.lake, campaign, state)]
    printing = [_print_batch(campaign, state, batch) for batch in batches if not state.is_confirmed(batch)]
    return [*printing, *_of_search(campaign.lake, campaign, state)]


def _print_batch(campaign: Campaign, state: CampaignState, batch: int) -> PrintTodo:
    lake, name = campaign.lake, campaign.campaign_id
    designs = {tool.slot: tool.design for tool in state.tools_of(batch)}
    slots = [_print_slot(batch, slot, designs[slot]) for slot in open_slots(lake, name, batch)]
    return PrintTodo(name, batch, tuple(slots), below_outputs(lake, print_folder(lake, name, batch) / SHEET))


def _print_slot(batch: int, slot: int, design: Design) -> PrintSlot:
    values = design.model_dump()
    walls = [f"{name} {values[key]:.2f}" for name, key in
             (("front", "front_thickness_mm"), ("back", "back_thickness_mm"), ("ribs", "rib_thickness_mm"))
             if key in values]  # fmt: skip
    words = f"{', '.join(walls)} mm" if walls else ""
    is_reference = find_reference(design) is not None
    return PrintSlot(
        slot, tool_label(batch, slot), draw_path(design), design.height_mm, design.length_mm, words, is_reference
    )


def _tell_batch(campaign: Campaign, state: CampaignState, batch: int) -> ToldTodo:
    folder = bench_folder(campaign.lake, campaign.campaign_id, batch)
    n_left = len(plan_batch(campaign, state, batch))
    return _told(campaign, batch, n_left, folder)


def _told(campaign: Campaign, batch: int | None, n_left: int, folder: Path) -> ToldTodo:
    lake = campaign.lake
    table, sheet = below_outputs(lake, folder / RESULTS), below_outputs(lake, folder / SHEET)
    return ToldTodo(campaign.campaign_id, batch, n_left, table, sheet)


def _of_search(lake: Lake, campaign: Campaign | None, state: CampaignState | None) -> list[Todo]:
    """List what the newest search of a campaign, or of the whole lake, asks for."""
    campaign_id = campaign.campaign_id if campaign is not None else None
    run = find_newest_run(lake, campaign_id)
    asked = run.findings.next_experiment if run is not None else None
    if run is None or asked is None:
        return []
    if asked.person is not None:
        known = find_measurement(asked.person.kind)
        if known is None or is_answered(lake, run.gap_id, asked.person.kind):
            return []
        instruction = known.words[0].upper() + known.words[1:]
        return [ReadingTodo(campaign_id or "", run.gap_id, asked.person, instruction)]
    still_open = read_open_requests(lake, search_id=run.gap_id)
    if campaign is None or state is None or not still_open:
        return []
    if campaign.config.bench.is_folder:
        return [_told(campaign, None, len(still_open), campaign.output / f"asked-{run.gap_id}")]
    if read_mounting(lake, run.gap_id) is not None:
        return []
    try:
        slots = plan_rack(lake, state, run.gap_id)
    except UsageError:  # a tool that was never printed: the campaign says so
        return []
    return [MountTodo(campaign.campaign_id, run.gap_id, slots, asked.sentence)]


def below_outputs(lake: Lake, path: Path) -> str:
    """Return a file of the lake's outputs as an address of the page; empty where it is not there."""
    outputs = lake.root / "outputs"
    return f"/outputs/{path.relative_to(outputs).as_posix()}" if path.exists() else ""
