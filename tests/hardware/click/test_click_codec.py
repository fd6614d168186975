import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fast.hardware.click.codec import BLOCKS, pack_value, parse_address, unpack_value
from fast.models.errors import UsageError


@pytest.mark.parametrize(
    ("name", "wire"),
    [
        ("X001", 0),
        ("X16", 15),
        ("X021", 16),
        ("X36", 31),
        ("X101", 32),
        ("X816", 271),
        ("Y1", 8192),
        ("y101", 8224),
        ("C1", 16384),
        ("C2000", 18383),
        ("T1", 45056),
        ("CT1", 49152),
        ("SC1", 61440),
        ("DS1", 0),
        ("DS4500", 4499),
        ("DD1", 16384),
        ("DD2", 16386),
        ("DH1", 24576),
        ("DF1", 28672),
        ("DF500", 29670),
        ("TXT1", 36864),
        ("TXT3", 36865),
        ("TXT999", 37363),
        ("TD1", 45056),
        ("CTD2", 49154),
        ("XD0", 57344),
        ("YD8", 57864),
        ("SD1", 61440),
    ],
)
def test_wire_addresses_are_the_documented_ones_minus_one(name, wire):
    assert parse_address(name).wire == wire


def test_every_address_maps_to_the_wire_and_back_without_collision():
    seen: set[tuple[str, int]] = set()
    for block in BLOCKS.values():
        for first, last in block.ranges:
            for number in range(first, last + 1, block.step):
                wire = block.wire_of(number)
                assert (block.space, wire) not in seen, f"{block.name}{number} shares its wire address"
                seen.update((block.space, wire + word) for word in range(block.width))
                assert block.number_at(wire) == number


def test_gaps_and_second_words_have_no_address():
    assert not [
        block.name for block in BLOCKS.values() if block.space == "discrete" and block.number_at(8000) is not None
    ]
    assert BLOCKS["DF"].number_at(28673) is None, "second word of DF1"


@pytest.mark.parametrize("name", ["X17", "X20", "X37", "X117", "C0", "C2001", "DF501", "DF0"])
def test_numbers_that_do_not_exist_are_named(name):
    with pytest.raises(UsageError, match=f"{name} does not exist"):
        parse_address(name)


def test_a_register_of_text_has_one_address():
    with pytest.raises(UsageError, match="TXT2 is the second character in the register of TXT1"):
        parse_address("TXT2")


def test_unknown_bank_gets_a_suggestion():
    with pytest.raises(UsageError, match="`DSS`; did you mean `DS`"):
        parse_address("DSS1")
    with pytest.raises(UsageError, match="not a CLICK address"):
        parse_address("first valve")


def test_floats_and_long_integers_travel_low_word_first():
    assert pack_value("float32", 30.0) == [0x0000, 0x41F0]
    assert pack_value("float32", 30.5) == [0, 16884]
    assert pack_value("int32", 65537) == [1, 1]
    assert pack_value("int32", -2) == [0xFFFE, 0xFFFF]
    assert pack_value("int16", -1) == [0xFFFF]


@given(st.integers(-(2**31), 2**31 - 1))
def test_integers_round_trip(value):
    assert unpack_value("int32", pack_value("int32", value)) == value


@given(st.floats(width=32, allow_nan=False, allow_infinity=False))
def test_floats_round_trip(value):
    assert unpack_value("float32", pack_value("float32", value)) == value


@given(st.text(alphabet="AZaz09", max_size=2))
def test_text_round_trips(text):
    assert unpack_value("text", pack_value("text", text)) == text


def test_a_value_that_does_not_fit_is_refused():
    with pytest.raises(UsageError, match="40000 does not fit the CLICK type int16"):
        pack_value("int16", 40000)


@pytest.mark.parametrize(
    ("kind", "value"),
    [
        ("float32", float("nan")),
        ("float32", float("inf")),
        ("float32", 1e39),
        ("int32", float("nan")),
        ("int32", 2**31),
        ("uint16", -1),
        ("text", "abc"),
        ("text", "\u00e9"),
    ],
)
def test_every_value_that_does_not_fit_is_refused_in_words(kind, value):
    with pytest.raises(UsageError, match=f"does not fit the CLICK type {kind}"):
        pack_value(kind, value)


WORD = st.integers(0, 0xFFFF)


@given(st.sampled_from(["int16", "uint16", "text"]), WORD)
def test_any_register_reads_as_something(kind, word):
    unpack_value(kind, [word])


@given(st.sampled_from(["int32", "float32"]), WORD, WORD)
def test_any_pair_of_registers_reads_as_something(kind, low, high):
    unpack_value(kind, [low, high])


@given(st.text(max_size=8))
def test_any_text_is_an_address_or_a_sentence(name):
    with contextlib.suppress(UsageError):
        assert parse_address(name).wire >= 0
