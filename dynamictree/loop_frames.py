"""Which numbers of frames make a loop: whole periods."""


def is_whole(periods: float) -> bool:
    """Whether these are periods without a rest, at least one."""
    return round(periods) >= 1 and abs(periods - round(periods)) < 1e-6


def nearest_loops(count: int, period_frames: float, most: int) -> str:
    """Advice with the numbers of frames up to `most` that make a loop, next to `count`."""
    loops = [count for count in range(1, most + 1) if is_whole(count / period_frames)]
    if not loops:
        return (
            f"no number of frames up to {most} makes a loop at this fps and speed: take fps 24, a period_s that "
            "fits, or loop=false"
        )
    below = [loop for loop in loops if loop < count][-1:]
    above = [loop for loop in loops if loop > count][:1]
    return f"{' or '.join(map(str, below + above))} frames make a loop; or take loop=false"
