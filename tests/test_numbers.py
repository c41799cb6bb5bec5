"""Text of numbers: the quick way gives what ``float`` and ``%.6f`` give, or leaves it to them."""

import numpy as np
import pytest

from torchquat.io._numbers import fixed_point, plain_numbers


def random_texts(generator, count):
    """Plain decimal numbers in all their spellings."""
    for _ in range(count):
        front = str(generator.integers(0, 10 ** generator.integers(0, 7)))
        back = "".join(map(str, generator.integers(0, 10, generator.integers(0, 9))))
        text = generator.choice(["", "-", "+"]) + front
        yield text + ("." + back if back else generator.choice(["", "."]))


def test_plain_numbers_are_those_of_float():
    generator = np.random.default_rng(0)
    texts = [*random_texts(generator, 5000), ".5", "-.5", "-0.0", "-0", "+0.", "999999999999999"]
    rows, counts, start = [], [], 0
    while start < len(texts):
        count = int(generator.integers(0, 6))
        space = generator.choice([" ", "  ", "\t", " \t "])
        end = generator.choice(["\n", "\r\n", " \n"])
        rows.append((space.join(texts[start : start + count]) + end).encode())
        counts.append(len(texts[start : start + count]))
        start += count
    numbers, found = plain_numbers(rows)
    expected = np.array([float(text) for text in texts])
    assert numbers.tobytes() == expected.tobytes(), "not the same to the last bit"
    assert found.tolist() == counts


@pytest.mark.parametrize(
    "text",
    [
        "1e5",
        "nan",
        "1.2.3",
        "--5",
        "1-2",
        "+-1",
        ".",
        "-",
        "- 5",
        "1234567890.123456",
        "1_0",
        "0x1",
    ],
)
def test_other_text_is_left_to_float(text):
    assert plain_numbers([b"1.5 2\n", text.encode() + b" 3\n"]) is None


@pytest.mark.parametrize("rows", [[], [b"\n"], [b"", b" \r\n"]])
def test_no_numbers(rows):
    numbers, counts = plain_numbers(rows)
    assert numbers.size == 0
    assert counts.tolist() == [0] * len(rows)


def test_fixed_point_is_that_of_format():
    generator = np.random.default_rng(0)
    values = generator.normal(size=(200, 7)) * 10.0 ** generator.integers(-8, 3, (200, 7))
    values[0] = [0.0, -0.0, -4e-7, 4e-7, 999.9999994, -999.0, 99.9999996]
    values = np.clip(values, -999.9, 999.9999994)
    expected = [" ".join(f"{c:.6f}" for c in row).encode() for row in np.round(values, 6) + 0.0]
    assert fixed_point(values) == expected
    assert fixed_point(np.empty((0, 3))) == []


@pytest.mark.parametrize("value", [999.9999996, -1000.0, np.nan, np.inf])
def test_large_numbers_are_left_to_format(value):
    assert fixed_point(np.array([[1.0, value]])) is None
