"""What the report says of a reconstruction."""

from dynamictree.reconstruct.report import quality_warnings


def test_a_splat_hardly_better_than_one_colour_is_warned_of():
    (warning,) = quality_warnings([14.0, 15.8], [12.0, 12.0])
    assert "14.9 dB, a picture of one colour has 12.0 dB" in warning
    assert quality_warnings([14.0, 16.2], [12.0, 12.0]) == []
