"""A small versioned interface for programs: what the page shows, as JSON, with a schema at `/api/v1/openapi.json`."""

from typing import Any

from fastapi import APIRouter, FastAPI, Security
from fastapi.security import APIKeyHeader, HTTPBasic
from pydantic import BaseModel, Field
from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from fast.flows.page import results
from fast.flows.page.lab import LabPage
from fast.flows.page.proposals import Proposal, list_open, write_proposal
from fast.flows.page.start import simulate_one
from fast.flows.page.todo import BenchTodo, MountTodo, PrintTodo, ReadingTodo, Todo, list_campaigns
from fast.flows.page.web import HEADERS, TOKEN_HEADER, NotAllowedError, require_token, visitor_of
from fast.flows.server.access import Role
from fast.flows.server.server import address_for_others
from fast.models.errors import FastError, UsageError
from fast.models.units import spell_count

VERSION = "/api/v1"
_KEY = Security(HTTPBasic(auto_error=False, description="user `fast`, and the key of a link as password"))
_TOKEN = Security(APIKeyHeader(name=TOKEN_HEADER, auto_error=False, description="of `GET /me`; a write carries it"))


class UnknownError(UsageError):
    """The lake has nothing of this name."""


class Refusal(BaseModel):
    """Why something was refused; nothing was done."""

    detail: str


_REFUSALS: dict[int | str, dict[str, Any]] = {
    400: {"model": Refusal, "description": "what was sent cannot be used"},
    401: {"content": {"text/plain": {}}, "description": "the key is missing or wrong"},
    403: {"model": Refusal, "description": "this key may not do it, or the token is missing"},
    404: {"model": Refusal, "description": "the lake has nothing of this name"},
    409: {"model": Refusal, "description": "it cannot be done now"},
}


class CampaignState(BaseModel):
    """Where a campaign stands."""

    campaign_id: str = Field(description="of the lake")
    state: str = Field(description="in a word: running, waiting, pausing, paused, stopped, complete ...")
    run: str = Field(description="names the run that goes on, or the last one; orders name it")
    grasps_done: int = Field(description="measured")
    grasps_total: int = Field(description="that the schedule measures, without what is rejected or left out")
    simulated_done: int = Field(description="grasps that are simulated")
    simulated_total: int = Field(description="grasps that the schedule simulates")
    person: str = Field(description="when a person is needed, and for what")
    left: str = Field(description="how long the rest takes")
    best_tool_id: str | None = Field(description="of the best measured finger; null before there is one")
    best_quality_n: float | None = Field(description="mean peak pull-off force, N")
    simulator_version_id: str = Field(description="of the simulator in use")
    simulator_misses: str = Field(description="what the newest gap search found; empty: not searched")
    fault: str = Field(description="why the last run failed; empty if it did not")


class AskedOfPerson(BaseModel):
    """Something that a person is asked for."""

    campaign_id: str
    kind: str = Field(description="print, mount, reading, grasps, bench or proposal")
    sentence: str


class SqlQuestion(BaseModel):
    """One SELECT over the tables, views and macros of the lake."""

    sql: str = Field(max_length=20_000)


class SqlRows(BaseModel):
    """The first rows of an answer."""

    columns: list[str]
    rows: list[list[Any]]
    n_rows: int


class Visit(BaseModel):
    """What the bearer of a key may do."""

    role: str
    token: str


class WantedGrasp(BaseModel):
    """A grasp to simulate; without a tool, of the best published finger."""

    object_id: int = Field(ge=0)
    tool_id: str = ""


class SimulatedGrasp(BaseModel):
    """A simulated grasp, in N.

    peak_sd_n: standard deviation of the peak between prints and mountings, None where it is not known; sd_is_of: of
    which tolerances.
    """

    title: str
    peak_force_n: float
    peak_sd_n: float | None
    sd_is_of: str
    measured_n: list[float | None]
    version_id: str


class Proposed(BaseModel):
    """A proposal that waits."""

    proposal_id: str
    sentence: str


class Finding(BaseModel):
    """What a gap search found."""

    gap_id: str = Field(description="of the search")
    campaign_id: str | None = Field(description="null: all measurements of the lake")
    answer: str = Field(description="a sentence or two")
    rmse_before_n: float = Field(description="root mean square difference of held-out traces before, N")
    rmse_after_n: float = Field(description="the same with what was added to the simulator, N")
    rmse_floor_n: float = Field(description="scatter of repeats or what meshes change, whichever is larger, N")
    asks: str = Field(description="the next experiment; empty: nothing is asked")
    simulator_version_id: str = Field(description="of the simulator that the search ended with")
    page: str = Field(description="address of its report; empty where there is none")


def add_interface(app: FastAPI, page: LabPage) -> None:
    """Add the routes for programs."""
    router = APIRouter(prefix=VERSION, dependencies=[_KEY], responses=_REFUSALS)
    _add_reads(router, page)
    _add_writes(router, page)
    app.include_router(router)


def _add_reads(router: APIRouter, page: LabPage) -> None:
    @router.get("/campaigns")
    def read_campaigns() -> list[str]:
        """List campaigns of the lake, the newest first."""
        return list_campaigns(page.lake)

    @router.get("/campaigns/{campaign_id}")
    def read_state(campaign_id: str) -> CampaignState:
        """Tell where a campaign stands."""
        return _describe_state(page, campaign_id)

    @router.get("/todo")
    def read_todo() -> list[AskedOfPerson]:
        """List what people are asked for now."""
        proposed = [
            AskedOfPerson(campaign_id=one.campaign_id, kind="proposal", sentence=f"{one.who} proposes: {one.why}")
            for one in list_open(page.lake).values()
        ]
        return [*(describe_todo(todo) for todo in page.read_todos()), *proposed]

    @router.get("/tools")
    def read_tools() -> list[dict[str, Any]]:
        """List measured tools, best first; forces in N, work in J."""
        return results.list_tools(page.lake)

    @router.get("/findings")
    def read_findings() -> list[Finding]:
        """List what gap searches found, the newest first."""
        return _list_findings(page)

    @router.post("/sql")
    def ask(question: SqlQuestion) -> SqlRows:
        """Answer a question; reads only, within the limits of the page."""
        found = results.query_sql(page.lake, question.sql, results.for_programs)
        return SqlRows(columns=list(found.columns), rows=[list(row) for row in found.rows], n_rows=found.n_rows)

    @router.get("/me")
    def read_me(request: Request) -> Visit:
        """Tell what the bearer of this key may do, and the token that a write carries in `X-Fast-Token`."""
        return Visit(role=visitor_of(request).role, token=page.token)


def _add_writes(router: APIRouter, page: LabPage) -> None:
    @router.post("/simulate", dependencies=[_TOKEN])
    def simulate(wanted: WantedGrasp, request: Request) -> SimulatedGrasp:
        """Simulate one grasp with the simulator of the tool's campaign; takes seconds."""
        require_token(request, page.token)
        address = address_for_others(page.lake)
        found = page.worker.call(simulate_one, address, wanted.tool_id, wanted.object_id)
        return SimulatedGrasp.model_validate({name: found[name] for name in SimulatedGrasp.model_fields})

    @router.get("/proposals")
    def read_proposals() -> dict[str, Proposal]:
        """Read the proposals that wait for a person, by id."""
        return list_open(page.lake)

    @router.post("/proposals", dependencies=[_TOKEN])
    def propose(proposal: Proposal, request: Request) -> Proposed:
        """Propose something to a person, who accepts or denies it on the page; nothing is started by this."""
        require_token(request, page.token)
        if not visitor_of(request).role.may(Role.SAY):
            raise NotAllowedError("This key lets you look, not say; ask for the other link.")
        proposal_id = write_proposal(page.lake, proposal)
        page.forget()
        return Proposed(proposal_id=proposal_id, sentence="A person decides on the lab's page, tab To do.")


def _describe_state(page: LabPage, campaign_id: str) -> CampaignState:
    """Describe where a campaign stands.

    Raises:
        UnknownError: there is none that can be shown.
    """
    now = page.read_now(campaign_id) if campaign_id in list_campaigns(page.lake) else None
    strip = page.read_strip(campaign_id, now) if now is not None else None
    if now is None or strip is None:
        raise UnknownError(f"This lake has no campaign `{campaign_id}` that can be shown.")
    return CampaignState(
        campaign_id=campaign_id,
        state=strip.word,
        run=strip.run,
        grasps_done=now.load.grasps_done,
        grasps_total=now.load.grasps_total,
        simulated_done=now.load.simulated_done,
        simulated_total=now.load.simulated_total,
        person=now.need,
        left=now.left,
        best_tool_id=now.best.tool_id if now.best else None,
        best_quality_n=now.best.quality_n if now.best else None,
        simulator_version_id=now.version,
        simulator_misses=now.misses,
        fault=strip.fault,
    )


def _list_findings(page: LabPage) -> list[Finding]:
    from fast.flows.report.gap.sentences import describe_findings

    return [
        Finding(
            gap_id=run.gap_id,
            campaign_id=run.campaign_id,
            answer=describe_findings(run.findings),
            rmse_before_n=run.findings.gap.rmse_before_n,
            rmse_after_n=run.findings.gap.rmse_after_n,
            rmse_floor_n=run.findings.gap.rmse_floor_n,
            asks=run.findings.next_experiment.sentence if run.findings.next_experiment else "",
            simulator_version_id=run.after_version_id,
            page=address,
        )
        for run, address in results.list_searches(page.lake)
    ]


def refuse_program(error: FastError) -> Response:
    """Return an error as a program is told of it: `Refusal`, with the status of its kind."""
    kinds = {NotAllowedError: 403, UnknownError: 404, UsageError: 400}
    status = next((status for kind, status in kinds.items() if isinstance(error, kind)), 409)
    return JSONResponse({"detail": str(error)}, status, HEADERS)


def describe_todo(todo: Todo) -> AskedOfPerson:
    """Describe what a person is asked for, in a sentence."""
    if isinstance(todo, BenchTodo):
        return AskedOfPerson(campaign_id=todo.campaign_id, kind="bench", sentence=todo.asked.question.sentence)
    if isinstance(todo, PrintTodo):
        return AskedOfPerson(
            campaign_id=todo.campaign_id,
            kind="print",
            sentence=f"print and mount {spell_count(len(todo.slots), 'tool')} of batch {todo.name}",
        )
    if isinstance(todo, MountTodo):
        names = ", ".join(tool.rpartition("/")[2] for tool in todo.slots)
        return AskedOfPerson(campaign_id=todo.campaign_id, kind="mount", sentence=f"mount kept tools again: {names}")
    if isinstance(todo, ReadingTodo):
        return AskedOfPerson(campaign_id=todo.campaign_id, kind="reading", sentence=todo.question.sentence)
    sentence = f"make and tell {spell_count(todo.n_left, 'grasp')} of {todo.name}"
    return AskedOfPerson(campaign_id=todo.campaign_id, kind="grasps", sentence=sentence)
