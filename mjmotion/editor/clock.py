"""Which frame is shown: play, pause, speed, loop, seek."""

from __future__ import annotations

SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0)
_LONGEST_TICK = 2.0  # after a longer pause of the page the clip goes on where it was [s]


class Clock:
    """Plays frames 0 to ``nframe`` − 1.

    Args:
      nframe: how many frames there are.
      fps: frames a second.

    Attributes:
      playing, loop: whether it runs, and whether it begins again at the end.
      speed: times the clip's own.
    """

    def __init__(self, nframe: int, fps: float) -> None:
        self.nframe, self.fps = nframe, fps
        self.playing, self.loop, self.speed = False, True, 1.0
        self._at = 0.0

    @property
    def frame(self) -> int:
        """The frame that is shown."""
        return int(self._at)

    def tick(self, seconds: float) -> None:
        """Let time pass [s]."""
        if not self.playing or seconds <= 0.0:
            return
        self._at += min(seconds, _LONGEST_TICK) * self.fps * self.speed
        if self._at >= self.nframe:
            if self.loop:
                self._at %= self.nframe
            else:
                self._at, self.playing = self.nframe - 1.0, False

    def seek(self, frame: int) -> None:
        """Go to a frame, or to the nearest that there is."""
        self._at = float(min(max(frame, 0), self.nframe - 1))

    def step(self, frames: int) -> None:
        """Pause, and go on by some frames."""
        self.playing = False
        self.seek(self.frame + frames)

    def play(self, on: bool) -> None:
        """Play or pause; at the end it begins again."""
        if on and self.frame >= self.nframe - 1:
            self.seek(0)
        self.playing = on

    def faster(self, steps: int) -> None:
        """Go to a higher speed, or to a lower one."""
        nearest = min(range(len(SPEEDS)), key=lambda i: abs(SPEEDS[i] - self.speed))
        self.speed = SPEEDS[min(max(nearest + steps, 0), len(SPEEDS) - 1)]
