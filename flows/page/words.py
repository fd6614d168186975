"""What people say and order on the page: each word is a function of a form, with the role that it takes.

Notes and photos of a tool are events of the lake, and files of its outputs.
"""

import hashlib
from collections.abc import Callable, Mapping
from functools import partial
from types import ModuleType
from typing import Any

from fastapi import FastAPI
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import Response

from fast.flows.campaign.status import read_campaign
from fast.flows.page import by_hand, start
from fast.flows.page.lab import LabPage
from fast.flows.page.proposals import settle_proposal
from fast.flows.page.todo import list_campaigns
from fast.flows.page.web import (
    HEADERS,
    MOST_FILE_BYTES,
    clean_name,
    keep_name,
    read_body,
    read_form,
    require_token,
    require_write,
    say,
)
from fast.flows.server.access import Role
from fast.flows.server.server import address_for_others
from fast.hardware.parts.safe_state import Verb
from fast.lake.store import Lake
from fast.lake.tables.campaign import ToolRow
from fast.models.errors import UsageError
from fast.tasks.bench.leave_out import leave_out as leave_part_out
from fast.tasks.bench.questions import answer_question
from fast.tasks.campaign.left_out import Part
from fast.tasks.campaign.present_run import request_verb
from fast.tasks.campaign.requests import append_event
from fast.tasks.campaign.simulator_versions import at_present

# What a form makes of the lake, and the sentence that tells the person; arguments: page, form, name of the person.
Word = Callable[[LabPage, dict[str, str], str], str]
Trial = Callable[[LabPage, dict[str, str]], dict[str, Any]]
NOTE = "note"  # kind of the events of notes and photos
MOST_PHOTO_BYTES = 15_000_000
_LONGEST = 1000
_PICTURES = {b"\xff\xd8\xff": ".jpg", b"\x89PNG\r\n\x1a\n": ".png", b"RIFF": ".webp"}


def add_words(app: FastAPI, page: LabPage) -> None:
    """Add names, orders, answers, told files, and what is started."""

    async def give_name(request: Request) -> Response:
        require_token(request, page.token)
        form = await read_form(request)
        name = clean_name(form.get("name", ""))
        if not name:
            raise UsageError("Say a name, so that the lake can keep who did what.")
        answer = say(Response(status_code=204, headers=HEADERS), f"Hello {name}.")
        answer.headers["HX-Refresh"] = "true"
        keep_name(request, answer, name)
        return answer

    async def look_at_file(request: Request) -> Response:
        require_write(request, page.token, Role.SAY)
        campaign_id = _campaign_of(page, dict(request.query_params))
        content = await read_body(request, MOST_FILE_BYTES)

        def work() -> Response:
            upload = _answers().keep_upload(page.lake, request.query_params.get("name", ""), content)
            dropped = page.worker.call(_answers().look_at_upload, page.lake, campaign_id, upload)
            return page.pages.show(request, "dropped.html", dropped=dropped, campaign=campaign_id)

        return await run_in_threadpool(work)

    async def take_photo(request: Request) -> Response:
        visitor = require_write(request, page.token, Role.SAY)
        content = await read_body(request, MOST_PHOTO_BYTES)
        about = request.query_params.get("about", "")
        sentence = await run_in_threadpool(keep_photo, page.lake, about, content, visitor.operator)
        return say(Response(status_code=204, headers=HEADERS), sentence)

    for path, handler in {"/who": give_name, "/todo/told/look": look_at_file, "/results/photo": take_photo}.items():
        app.add_api_route(path, handler, methods=["POST"], include_in_schema=False)
    for path, (template, try_out) in TRIALS.items():
        _add_trial(app, page, path, template, try_out)
    for path, (role, word) in WORDS.items():
        _add_word(app, page, path, role, word)


def _add_word(app: FastAPI, page: LabPage, path: str, role: Role, word: Word) -> None:
    async def handle(request: Request) -> Response:
        return await page.write(request, role, partial(word, page))

    app.add_api_route(path, handle, methods=["POST"], include_in_schema=False)


def _add_trial(app: FastAPI, page: LabPage, path: str, template: str, try_out: Trial) -> None:
    """Add a form that changes nothing, answered by a part of the page."""

    async def handle(request: Request) -> Response:
        require_token(request, page.token)
        form = await read_form(request)
        return page.pages.show(request, template, **await run_in_threadpool(try_out, page, form))

    app.add_api_route(path, handle, methods=["POST"], include_in_schema=False)


def _check_config(page: LabPage, form: dict[str, str]) -> dict[str, Any]:
    text = form.get("text", "").replace("\r\n", "\n")
    return {"checked": start.check_config(page.lake, text, form.get("base", ""))}


def _simulate(page: LabPage, form: dict[str, str]) -> dict[str, Any]:
    number = form.get("object", "")
    if not number.isdecimal():
        raise UsageError("Choose an object.")
    wanted = address_for_others(page.lake), form.get("tool", ""), int(number)
    return {"found": page.worker.call(start.simulate_one, *wanted)}


TRIALS: Mapping[str, tuple[str, Trial]] = {
    "/start/check": ("checked.html", _check_config),
    "/start/simulate": ("simulated.html", _simulate),
}


def _request(page: LabPage, form: dict[str, str], operator: str, verb: Verb) -> str:
    return request_verb(page.lake, _campaign_of(page, form), verb, f"by {operator} on the lab's page", form.get("run"))


def _leave_out(page: LabPage, form: dict[str, str], operator: str) -> str:
    campaign = at_present(read_campaign(page.lake, _campaign_of(page, form)))
    try:
        part = Part.model_validate_json(form.get("part", ""))
    except ValueError as error:
        raise UsageError("Choose what is left out; nothing was changed.") from error
    return leave_part_out(campaign, part, form.get("reason", ""), operator, is_out="back" not in form)


def _say_printed(page: LabPage, form: dict[str, str], operator: str) -> str:
    said = _answers().answer_print(page.lake, _campaign_of(page, form), _whole(form, "batch"), form, operator)
    return str(said)


def _say_mounted(page: LabPage, form: dict[str, str], operator: str) -> str:
    said = _answers().answer_mount(page.lake, _campaign_of(page, form), form.get("search", ""), form, operator)
    return str(said)


def _say_reading(page: LabPage, form: dict[str, str], operator: str) -> str:
    campaign_id, search_id = form.get("campaign", ""), form.get("search", "")
    return str(_answers().answer_reading(page.lake, campaign_id, search_id, form, operator))


def _undo_reading(page: LabPage, form: dict[str, str], operator: str) -> str:
    campaign_id, search_id = form.get("campaign", ""), form.get("search", "")
    return str(_answers().undo_reading(page.lake, campaign_id, search_id, form.get("kind", ""), operator))


def _decide(page: LabPage, form: dict[str, str], operator: str) -> str:
    text = form.get("config", "").replace("\r\n", "\n")
    return settle_proposal(page.lake, form.get("proposal", ""), form.get("accept") == "yes", text, operator)


def _say_to_bench(page: LabPage, form: dict[str, str], operator: str) -> str:
    values = {name.removeprefix("field-"): text for name, text in form.items() if name.startswith("field-")}
    name, asked = _campaign_of(page, form), form.get("question", "")
    return answer_question(page.lake, name, asked, form.get("choice", ""), values, operator)


def _write_file(page: LabPage, form: dict[str, str], operator: str) -> str:
    return str(page.worker.call(_answers().write_upload, page.lake, _campaign_of(page, form), form, operator))


def _undo_file(page: LabPage, form: dict[str, str], operator: str) -> str:
    return str(_answers().undo_told(page.lake, _campaign_of(page, form), operator))


def _continue(page: LabPage, form: dict[str, str], operator: str) -> str:
    return start.continue_campaign(page.lake, _campaign_of(page, form), form.get("run", ""), operator)


def _take_way(page: LabPage, form: dict[str, str], operator: str) -> str:
    return start.go_on_after_fault(page.lake, {**form, "campaign": _campaign_of(page, form)}, operator)


def _start_job(page: LabPage, form: dict[str, str], operator: str) -> str:
    return start.start_job(page.lake, form.get("job", ""), form.get("campaign", ""), operator)


WORDS: Mapping[str, tuple[Role, Word]] = {
    "/orders/leave-out": (Role.MOVE, _leave_out),
    "/orders/pause": (Role.MOVE, partial(_request, verb=Verb.PAUSE)),
    "/orders/stop": (Role.MOVE, partial(_request, verb=Verb.STOP)),
    "/todo/print": (Role.SAY, _say_printed),
    "/todo/mount": (Role.SAY, _say_mounted),
    "/todo/reading": (Role.SAY, _say_reading),
    "/todo/reading/undo": (Role.SAY, _undo_reading),
    "/todo/proposal": (Role.MOVE, _decide),
    "/todo/question": (Role.MOVE, _say_to_bench),
    "/todo/told/write": (Role.SAY, _write_file),
    "/todo/told/undo": (Role.SAY, _undo_file),
    "/results/note": (Role.SAY, lambda page, form, who: keep_note(page.lake, form, who)),
    "/start/campaign": (Role.MOVE, lambda page, form, who: start.start_campaign(page.lake, form, who)),
    "/start/continue": (Role.MOVE, _continue),
    "/start/way": (Role.MOVE, _take_way),
    "/start/job": (Role.MOVE, _start_job),
    "/bench/order": (Role.MOVE, lambda page, form, who: by_hand.ask_bench(page.lake, form, who)),
}


def _answers() -> ModuleType:
    """Import what writes answers: seconds of imports, which whoever only looks does not wait for."""
    from fast.flows.page import answers

    return answers


def _campaign_of(page: LabPage, form: dict[str, str]) -> str:
    """Return the campaign that a form names.

    Raises:
        UsageError: the lake has none of that name.
    """
    campaign_id = form.get("campaign", "")
    if campaign_id not in list_campaigns(page.lake):
        raise UsageError(f"This lake has no campaign `{campaign_id}`; load the page again.")
    return campaign_id


def _whole(form: dict[str, str], name: str) -> int:
    text = form.get(name, "")
    if not text.isdecimal():
        raise UsageError(f"`{name}` of the form is not a whole number; load the page again.")
    return int(text)


def keep_note(lake: Lake, form: Mapping[str, str], operator: str) -> str:
    """Keep what a person wrote about a tool.

    Raises:
        UsageError: nothing was written, or there is no such tool.
    """
    about, text = form.get("about", ""), form.get("text", "")[:_LONGEST]
    if not text:
        raise UsageError("The note is empty; nothing was kept.")
    append_event(lake, _find_campaign(lake, about), NOTE, text, about=about, operator=operator)
    return "The note is kept."


def keep_photo(lake: Lake, about: str, content: bytes, operator: str) -> str:
    """Keep a photo of a tool.

    Raises:
        UsageError: it is no picture, or there is no such tool.
    """
    campaign_id = _find_campaign(lake, about)
    suffix = next((suffix for start, suffix in _PICTURES.items() if content.startswith(start)), None)
    if suffix is None or (suffix == ".webp" and content[8:12] != b"WEBP"):
        raise UsageError("This is no JPEG, PNG or WebP picture; nothing was kept.")
    name = f"{hashlib.sha256(content).hexdigest()[:20]}{suffix}"
    folder = lake.root / "outputs" / campaign_id / "photos"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_bytes(content)
    words = {"about": about, "operator": operator, "photo": f"/outputs/{campaign_id}/photos/{name}"}
    append_event(lake, campaign_id, NOTE, "photo", **words)
    return "The photo is kept."


def _find_campaign(lake: Lake, tool_id: str) -> str:
    rows = lake.rows(ToolRow, tool_id=tool_id)
    if not rows:
        raise UsageError(f"There is no tool `{tool_id}` in this lake.")
    return str(rows[-1]["campaign_id"])
