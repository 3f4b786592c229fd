"""What the paper's tables say, to stand beside ours.

Source: arXiv 2601.13657, the tables of comparison, scalability, reward ablation and real flights; the numbers
about observable neighbours are those that its text gives, for the figure has none. Each is a mean and the
standard deviation printed with it. The ablation's first block of "MS" is its MP: the values are.
"""

from dataclasses import dataclass

METRICS = ("SR", "MP", "FR", "MS", "AL", "MDO")
PROPOSED = "proposed"
METHODS = ("pacnav", "vpf", "reynolds_apf", PROPOSED)
"""As they are called here; `reynolds_apf` is the expert of the paper's "DAgger"."""
WORLDS = ("none", "pillars_10m", "pillars_5m", "simplified_forest", "forest")
GAPS = ("none", "pillars_10m", "pillars_5m")
FOLLOWERS = (2, 4, 6, 8, 10)
CONFIGURATIONS = (
    "without_flocking",
    "without_obstacle",
    "without_stable",
    "without_perception",
    "uniform",
    PROPOSED,
)
SITES = ("indoor_blocks", "indoor_wall", "outdoor_pillars", "display_tower", "short_forest")
TRIALS = 100
"""In every cell of the tables of simulations."""


@dataclass(frozen=True, slots=True)
class Published:
    """A number as printed.

    Attributes:
        mean: as printed.
        sd: printed after it; 0 for success rates, where it says nothing; None where the text gives none.
        digits: printed after the point.
    """

    mean: float
    sd: float | None
    digits: int

    @property
    def text(self) -> str:
        """As it stands in a table."""
        if not self.sd and self.digits <= 1:
            return f"{self.mean:.{self.digits}f}"
        return f"{self.mean:.{self.digits}f} ± {self.sd:.{self.digits}f}"


_COMPARISON = """
SR  pacnav        100.0±0.0  96.0±0.0   82.0±0.0   38.0±0.0   31.0±0.0
SR  vpf           100.0±0.0  80.0±0.0   27.0±0.0   6.0±0.0    5.0±0.0
SR  reynolds_apf  100.0±0.0  93.0±0.0   69.0±0.0   34.0±0.0   22.0±0.0
SR  proposed      100.0±0.0  99.0±0.0   97.0±0.0   97.0±0.0   72.0±0.0
MP  pacnav        100.0±0.0  98.6±8.8   93.0±18.6  72.2±26.6  67.6±28.2
MP  vpf           100.0±0.0  92.6±17.5  62.0±32.3  47.0±24.4  39.7±22.7
MP  reynolds_apf  100.0±0.0  97.1±11.4  85.6±25.4  74.5±25.9  69.1±24.0
MP  proposed      100.0±0.0  99.3±7.0   99.5±3.3   98.2±10.4  88.2±23.6
FR  pacnav        1.80±0.14  1.83±0.12  1.85±0.10  1.85±0.10  1.82±0.10
FR  vpf           2.20±0.44  2.23±0.55  2.54±1.57  2.44±1.44  2.31±0.79
FR  reynolds_apf  2.96±0.44  2.85±0.44  2.65±0.37  2.59±0.56  2.59±0.46
FR  proposed      1.61±0.13  1.56±0.12  1.47±0.09  1.40±0.06  1.39±0.15
MS  pacnav        1.23±0.07  1.25±0.06  1.26±0.06  1.27±0.04  1.25±0.05
MS  vpf           1.49±0.03  1.48±0.04  1.48±0.05  1.46±0.05  1.47±0.06
MS  reynolds_apf  1.54±0.11  1.53±0.11  1.51±0.11  1.49±0.13  1.49±0.13
MS  proposed      1.55±0.02  1.53±0.02  1.51±0.02  1.47±0.03  1.46±0.04
AL  pacnav        0.87±0.08  0.83±0.08  0.79±0.07  0.73±0.05  0.75±0.06
AL  vpf           0.92±0.03  0.92±0.04  0.89±0.06  0.89±0.05  0.87±0.09
AL  reynolds_apf  0.79±0.02  0.77±0.03  0.74±0.04  0.67±0.04  0.68±0.05
AL  proposed      0.94±0.01  0.94±0.01  0.93±0.02  0.90±0.02  0.88±0.11
MDO pacnav        -          2.18±0.33  1.89±0.40  0.82±0.45  0.82±0.32
MDO vpf           -          2.12±0.41  1.81±0.57  1.27±0.45  0.73±0.45
MDO reynolds_apf  -          1.89±0.40  1.52±0.54  0.93±0.58  0.76±0.41
MDO proposed      -          2.27±0.15  1.88±0.16  1.56±0.09  0.79±0.32
"""

_SCALABILITY = """
SR  none         100.0±0.0  100.0±0.0  100.0±0.0  98.0±0.0   93.0±0.0
SR  pillars_10m  100.0±0.0  99.0±0.0   96.0±0.0   84.0±0.0   70.0±0.0
SR  pillars_5m   93.0±0.0   97.0±0.0   88.0±0.0   56.0±0.0   46.0±0.0
MP  none         100.0±0.0  100.0±0.0  100.0±0.0  99.2±7.5   95.3±18.2
MP  pillars_10m  100.0±0.0  99.3±7.0   97.7±12.8  91.7±21.9  88.5±23.4
MP  pillars_5m   98.0±9.7   99.5±3.3   96.8±10.2  79.6±22.9  70.3±27.6
FR  none         1.13±0.18  1.61±0.13  1.93±0.06  2.15±0.06  2.32±0.05
FR  pillars_10m  1.08±0.15  1.56±0.12  1.88±0.06  2.14±0.06  2.33±0.06
FR  pillars_5m   1.04±0.13  1.47±0.09  1.85±0.05  2.12±0.05  2.32±0.07
MS  none         1.60±0.01  1.55±0.02  1.47±0.03  1.39±0.02  1.34±0.02
MS  pillars_10m  1.60±0.01  1.53±0.02  1.46±0.03  1.38±0.02  1.34±0.02
MS  pillars_5m   1.60±0.01  1.51±0.02  1.44±0.03  1.37±0.02  1.32±0.03
AL  none         0.97±0.02  0.94±0.01  0.89±0.02  0.85±0.02  0.84±0.04
AL  pillars_10m  0.97±0.02  0.94±0.01  0.89±0.02  0.85±0.02  0.84±0.03
AL  pillars_5m   0.97±0.02  0.93±0.02  0.88±0.02  0.84±0.03  0.83±0.04
MDO none         -          -          -          -          -
MDO pillars_10m  2.45±0.13  2.27±0.15  2.17±0.18  2.00±0.24  1.68±0.29
MDO pillars_5m   2.12±0.21  1.88±0.16  1.65±0.29  1.49±0.37  1.35±0.45
"""

_ABLATION = """
SR  none         0.0±0.0  96.0±0.0   11.0±0.0   99.0±0.0   82.0±0.0   100.0±0.0
SR  pillars_10m  0.0±0.0  96.0±0.0   9.0±0.0    96.0±0.0   74.0±0.0   99.0±0.0
SR  pillars_5m   0.0±0.0  86.0±0.0   3.0±0.0    67.0±0.0   54.0±0.0   97.0±0.0
MP  none         -        97.8±11.8  28.0±39.8  99.2±8.5   92.6±20.9  100.0±0.0
MP  pillars_10m  -        99.2±5.8   32.5±39.0  98.9±6.4   92.0±22.6  99.3±7.0
MP  pillars_5m   -        94.2±16.3  35.7±29.3  81.3±30.3  80.0±32.5  99.5±3.3
FR  none         -        2.02±0.11  3.60±0.87  2.29±0.15  2.85±0.26  1.61±0.13
FR  pillars_10m  -        2.03±0.10  3.35±0.79  2.26±0.14  2.86±0.25  1.56±0.12
FR  pillars_5m   -        2.00±0.09  2.94±0.78  2.23±0.14  2.83±0.29  1.47±0.09
MS  none         -        1.58±0.02  1.55±0.05  1.53±0.04  1.42±0.07  1.55±0.02
MS  pillars_10m  -        1.58±0.01  1.55±0.04  1.52±0.03  1.40±0.06  1.53±0.02
MS  pillars_5m   -        1.57±0.02  1.55±0.04  1.50±0.04  1.38±0.05  1.51±0.02
AL  none         -        0.94±0.02  0.90±0.04  0.94±0.01  0.95±0.02  0.94±0.01
AL  pillars_10m  -        0.94±0.01  0.90±0.04  0.94±0.01  0.94±0.02  0.94±0.01
AL  pillars_5m   -        0.94±0.02  0.90±0.04  0.92±0.03  0.93±0.03  0.93±0.02
MDO none         -        -          -          -          -          -
MDO pillars_10m  -        2.25±0.18  2.22±0.17  2.41±0.15  2.36±0.14  2.27±0.15
MDO pillars_5m   -        1.66±0.26  1.86±0.30  1.82±0.27  1.74±0.20  1.88±0.16
"""

_REAL_FLIGHTS = """
FR  2.31±0.28  2.54±0.28  2.86±0.53  2.60±0.27  2.30±0.30
MS  1.50±0.28  1.39±0.36  1.34±0.34  1.55±0.16  1.36±0.27
AL  0.48±0.40  0.52±0.42  0.72±0.34  0.81±0.21  0.74±0.30
MDO 1.88±0.92  4.25±1.45  2.82±1.83  5.82±4.69  1.57±1.13
"""


def _published(cell: str) -> Published | None:
    if cell == "-":
        return None
    mean, _, sd = cell.partition("±")
    return Published(float(mean), float(sd), len(mean.partition(".")[2]))


def _table(text: str) -> dict[tuple[str, ...], list[Published | None]]:
    """Return the numbers of a table by the words at the beginning of their row."""
    rows = {}
    for line in text.strip().splitlines():
        words = line.split()
        names = tuple(word for word in words if word[0].isalpha())
        rows[names] = [_published(cell) for cell in words[len(names) :]]
    return rows


COMPARISON: dict[tuple[str, str, str], Published | None] = {
    (metric, method, world): cell
    for (metric, method), cells in _table(_COMPARISON).items()
    for world, cell in zip(WORLDS, cells, strict=True)
}
"""By metric, method and world; four followers."""
SCALABILITY: dict[tuple[str, str, int], Published | None] = {
    (metric, world, followers): cell
    for (metric, world), cells in _table(_SCALABILITY).items()
    for followers, cell in zip(FOLLOWERS, cells, strict=True)
}
"""By metric, world and number of followers; the proposed method."""
REWARD_ABLATION: dict[tuple[str, str, str], Published | None] = {
    (metric, world, configuration): cell
    for (metric, world), cells in _table(_ABLATION).items()
    for configuration, cell in zip(CONFIGURATIONS, cells, strict=True)
}
"""By metric, world and configuration of rewards; four followers."""
REAL_FLIGHTS: dict[tuple[str, str], Published | None] = {
    (metric, site): cell
    for (metric,), cells in _table(_REAL_FLIGHTS).items()
    for site, cell in zip(SITES, cells, strict=True)
}
"""By metric and site; one flight each of five UAVs, mean and standard deviation over its time."""
NEIGHBOURS: dict[tuple[str, int], Published] = {
    ("none", 4): Published(94.0, None, 0),
    ("pillars_5m", 5): Published(26.0, None, 0),
    ("pillars_5m", 6): Published(46.0, None, 0),
    ("pillars_5m", 10): Published(50.0, None, 0),
}
"""Success rate by world and number of observable neighbours, ten followers, as far as the text says."""
