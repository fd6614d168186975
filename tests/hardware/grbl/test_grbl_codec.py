import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from fast.hardware.grbl.codec import LineDecoder, decode_line, encode_line, encode_message
from fast.hardware.grbl.codes import ALARMS, alarm_meaning, error_text
from fast.hardware.grbl.messages import (
    Alarm,
    Banner,
    ErrorReply,
    Feedback,
    Ok,
    Setting,
    StartupLine,
    StartupRan,
    StatusReport,
    Unknown,
)
from fast.models.errors import UsageError

# Lines as real controllers send them, and grblHAL's dialect.
KNOWN_LINES = [
    (b"ok", Ok()),
    (b"error:22", ErrorReply(22)),
    (b"ALARM:9", Alarm(9)),
    (b"Grbl 1.1g ['$' for help]", Banner("1.1g")),
    (b"GrblHAL 1.1f ['$' for help]", Banner("1.1f")),
    (b"$130=1500.000", Setting(130, 1500.0)),
    (b"$0=5.0", Setting(0, 5.0)),
    (b"$N0=G54", StartupLine(0, "G54")),
    (b">G54:error:9", StartupRan("G54", "error:9")),
    (b"[MSG:'$H'|'$X' to unlock]", Feedback("MSG", "'$H'|'$X' to unlock")),
    (b"[PRB:0.000,0.000,0.000:0]", Feedback("PRB", "0.000,0.000,0.000:0")),
    (b"[OPT:VNM+,35,255]", Feedback("OPT", "VNM+,35,255")),
    (b"<Idle|MPos:-3.000,-3.000,-3.000>", StatusReport("Idle", machine_mm=(-3.0, -3.0, -3.0))),
    (
        b"<Hold:1|WPos:1.000,2.000,3.000|Bf:15,128|Ln:7|FS:500,0|Pn:XZ|WCO:0.000,0.000,1.500|Ov:50,100,100|A:SF>",
        StatusReport(
            "Hold", 1, work_mm=(1.0, 2.0, 3.0), blocks_free=15, rx_free=128, line_number=7, feed_mm_per_min=500.0,
            spindle=0.0, pins="XZ", offset_mm=(0.0, 0.0, 1.5), overrides=(50, 100, 100), other=(("A", "SF"),),
        ),
    ),
    (
        b"<Run|MPos:1.000,2.000,3.000,4.000|F:500|H:1,7>",
        StatusReport("Run", machine_mm=(1.0, 2.0, 3.0, 4.0), feed_mm_per_min=500.0, other=(("H", "1,7"),)),
    ),
]  # fmt: skip


@pytest.mark.parametrize(("line", "message"), KNOWN_LINES)
def test_known_lines_are_understood(line, message):
    assert decode_line(line) == message


@pytest.mark.parametrize(
    "line",
    [
        b"okok",
        b"ok<Idle|MPos:0.000,0.000,0.000>",
        b"error:",
        b"ALARM:x",
        b"<Idle|MPos:0.000,0.000>",
        b"<Idle|MPos:0.000,0.0.0,0.000>",
        b"<Idle|MPos:1.000,2.000,3.000|MPos:4.000,5.000,6.000>",
        b"<Idle|FS:0,0>",
        b"<|MPos:0.000,0.000,0.000>",
        b"<Run|MPos:1.000,2.000,3.000|FS:5",
        b"$130=",
        b"\xffok",
    ],
)
def test_damaged_lines_are_unknown_rather_than_half_believed(line):
    assert decode_line(line) == Unknown(line)


@given(st.binary(max_size=300))
@example(b"<Idle|MPos:" + b"9" * 400 + b",0,0>\r\n$1=" + b"9" * 400 + b"\n")
def test_any_bytes_decode_without_raising_and_in_bounded_memory(data):
    decoder = LineDecoder()
    for message in decoder.feed(data * 10):
        assert encode_message(message)


@given(st.binary(max_size=200), st.lists(st.integers(0, 200), max_size=6))
def test_cutting_the_stream_anywhere_changes_nothing(noise, cuts):
    data = b"ok\r\n" + noise + b"\r\n<Idle|MPos:0.000,0.000,0.000>\r\nerror:9\r\n"
    whole = LineDecoder().feed(data)
    decoder, pieces, start = LineDecoder(), [], 0
    for cut in [*sorted(min(cut, len(data)) for cut in cuts), len(data)]:
        pieces += decoder.feed(data[start:cut])
        start = cut
    assert pieces == whole
    assert whole[-1] == ErrorReply(9)


def test_an_endless_line_is_given_up():
    decoder = LineDecoder()
    assert [type(message) for message in decoder.feed(b"x" * 3000)] == [Unknown]
    assert decoder.feed(b"\r\nok\r\n") == [Ok()]


_coordinate = st.integers(-9_999_999, 9_999_999).map(lambda micrometres: micrometres / 1000)
_vector = st.tuples(_coordinate, _coordinate, _coordinate)
_text = st.text(st.sampled_from("ABCXYZ0123456789 .,:$'|+-"), max_size=20).map(str.strip)
_reports = st.builds(
    StatusReport,
    state=st.sampled_from(["Idle", "Run", "Hold", "Jog", "Alarm", "Door", "Check", "Home", "Sleep"]),
    sub_state=st.none() | st.integers(0, 3),
    machine_mm=_vector,
    work_mm=st.none() | _vector,
    feed_mm_per_min=st.none() | st.integers(0, 99_999).map(float),
    pins=st.none() | st.sampled_from(["X", "XYZ", "PH"]),
    offset_mm=st.none() | _vector,
    overrides=st.none() | st.tuples(*[st.integers(10, 200)] * 3),
    line_number=st.none() | st.integers(0, 9_999_999),
)
_messages = st.one_of(
    st.just(Ok()),
    st.builds(ErrorReply, st.integers(0, 255)),
    st.builds(Alarm, st.integers(0, 255)),
    st.builds(Banner, st.sampled_from(["1.1f", "1.1g", "1.1h"])),
    st.builds(Setting, st.integers(100, 132), _coordinate),
    st.builds(Feedback, st.sampled_from(["MSG", "VER", "GC", "G54"]), _text),
    _reports,
)


@given(st.lists(_messages, max_size=8))
def test_what_a_controller_encodes_a_host_decodes(messages):
    assert LineDecoder().feed(b"".join(encode_message(message) for message in messages)) == messages


def test_lines_end_with_line_feed_only():
    assert encode_line("G1 X-1 F60") == b"G1 X-1 F60\n"
    assert encode_line("") == b"\n"


@pytest.mark.parametrize(
    ("line", "reason"),
    [("G1\nX1", "not printable"), ("G1 Xé", "not printable"), ("G1 X1 !", "real-time"), ("G" * 255, "255 characters")],
)
def test_lines_that_would_confuse_the_controller_are_refused(line, reason):
    with pytest.raises(UsageError, match=reason):
        encode_line(line)


def test_code_tables_say_what_holds_for_the_position():
    assert {code for code, meaning in ALARMS.items() if meaning.keeps_position} == {2, 4, 5}
    assert {code for code, meaning in ALARMS.items() if meaning.is_critical} == {1, 2, 10}
    assert not alarm_meaning(77).keeps_position
    assert error_text(15) == "target beyond travel"
    assert error_text(99) == "error of unknown meaning"


def test_moving_states():
    def is_moving(state, sub_state=None):
        return StatusReport(state, sub_state, machine_mm=(0.0, 0.0, 0.0)).is_moving

    assert [is_moving(state) for state in ("Run", "Jog", "Home", "Idle", "Alarm")] == [True, True, True, False, False]
    assert is_moving("Hold", 1)
    assert not is_moving("Hold", 0)
