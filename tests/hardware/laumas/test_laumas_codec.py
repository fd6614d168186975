import pytest
from hypothesis import given
from hypothesis import strategies as st

from fast.hardware.laumas.codec import (
    DIVISIONS,
    Scale,
    Status,
    decode_measured,
    decode_scale,
    encode_measured,
    encode_scale,
    magnitude,
)
from fast.models.errors import DeviceError

KILOGRAM = Scale(0.001, "kg")


def test_a_block_made_by_hand_reads_as_the_manual_says():
    # stable, net shown; gross 1 * 65536 + 4464 = 70000 counts, net 65536 counts, peak 70001 counts, 0.001 kg
    registers = [0x0C00, 1, 4464, 1, 0, 1, 4465, 15]
    reading = decode_measured(registers, KILOGRAM)
    assert reading.gross == pytest.approx(70.0)
    assert reading.net == pytest.approx(65.536)
    assert reading.peak == pytest.approx(70.001)
    assert reading.status & Status.STABLE
    assert not reading.fault


def test_the_sign_is_in_the_status_and_weights_are_magnitudes():
    reading = decode_measured([0x0180, 0, 250, 0, 1250, 0, 0, 15], KILOGRAM)
    assert (reading.gross, reading.net) == (pytest.approx(-0.25), pytest.approx(-1.25))


def test_twos_complement_of_some_firmware_is_undone_before_the_sign_is_applied():
    assert magnitude(0xFFFFFF06) == 250
    reading = decode_measured([0x0080, 0xFFFF, 0xFF06, 0, 0, 0, 0, 15], KILOGRAM)
    assert reading.gross == pytest.approx(-0.25)


@given(st.integers(-999_999, 999_999), st.integers(-999_999, 999_999), st.integers(0, 999_999))
def test_measured_registers_round_trip(gross, net, peak):
    registers = encode_measured(Status.STABLE, gross, net, peak, KILOGRAM)
    assert all(0 <= word <= 0xFFFF for word in registers)
    reading = decode_measured(registers, KILOGRAM)
    assert reading.gross == pytest.approx(gross * 0.001)
    assert reading.net == pytest.approx(net * 0.001)
    assert reading.peak == pytest.approx(peak * 0.001)


@given(st.integers(-(2**31) + 1, 2**31 - 1))
def test_every_weight_comes_back(counts):
    reading = decode_measured(encode_measured(0, counts, -counts, counts, KILOGRAM), KILOGRAM)

    assert (reading.gross, reading.net, reading.peak) == (counts * 0.001, -counts * 0.001, counts * 0.001)


@pytest.mark.parametrize("bit", range(6))
def test_every_fault_bit_has_words(bit):
    reading = decode_measured([1 << bit, 0, 0, 0, 0, 0, 0, 15], KILOGRAM)
    assert reading.fault


@pytest.mark.parametrize("code", range(len(DIVISIONS)))
def test_only_divisions_on_which_all_drivers_agree_are_accepted(code):
    if DIVISIONS[code] in (1, 0.1, 0.01, 0.001, 0.0001):
        scale = decode_scale(code)
        assert scale.division == pytest.approx(10.0**-scale.decimals), "counts x division = counts / 10^decimals"
        assert encode_scale(scale) == code
    else:
        with pytest.raises(DeviceError, match="ambiguous over Modbus; set it to 0.001 kg"):
            decode_scale(code)


def test_units_sit_in_the_high_byte_and_unknown_codes_are_refused():
    assert decode_scale(4 << 8 | 12) == Scale(0.01, "N")
    with pytest.raises(DeviceError, match="unit code 12"):
        decode_scale(12 << 8 | 15)
