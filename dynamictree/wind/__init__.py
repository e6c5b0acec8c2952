"""The wind: turbulent air, the loop's bins in it, gains by mean speed, and flutter of leaves."""
