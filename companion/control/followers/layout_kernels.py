"""Where things stand in the arrays that the followers' laws share; compiled into every law.

Frames: the heading frame has its origin in the own body, x where the nose points, z up; the map is the own
odometry's.
"""

METHOD_IDS = {"flock": 0, "pacnav": 1, "vpf": 2, "vpf_polar": 3, "reynolds_apf": 4, "lloyd": 5}
"""Number of each law, for `steer`."""

# What the vehicle knows about itself.
EGO_SIZE = 10
EGO_P = 0
EGO_V = 3
EGO_YAW = 6
EGO_HEIGHT = 7
EGO_DT = 8
EGO_ALONE = 9

# One row for each neighbour.
NEIGHBOUR_SIZE = 8
ROW_P = 0
ROW_V = 3
ROW_PRESENT = 6
ROW_ID = 7
MAX_ROWS = 20

# The obstacle grid: cell (0, 0) is straight ahead and lowest.
AZIMUTHS = 72
ELEVATIONS = 12
LOWEST_ELEVATION_DEG = -7.0
HIGHEST_ELEVATION_DEG = 52.0

# Parameters: what all laws share, then those of one law in the order of its settings.
MAX_SPEED = 0
MAX_VERTICAL_SPEED = 1
MAX_ACCELERATION = 2
HEIGHT_GAIN = 3
HEIGHT_SPEED = 4
RECOVERY_HEIGHT = 5
LAW_PARAMETERS = 8
PARAMETER_COUNT = 48

# Memory: what all laws share, then what one law remembers.
STARTED = 0
PREVIOUS = 1
LAW_MEMORY = 8

# `flock` remembers neighbours (number plus one, age, position, velocity), obstacles (time left, position),
# and has room for one distance in each direction.
FLOCK_SLOTS = LAW_MEMORY
FLOCK_SLOT_COUNT = 12
FLOCK_SLOT_SIZE = 8
FLOCK_POINTS = FLOCK_SLOTS + FLOCK_SLOT_COUNT * FLOCK_SLOT_SIZE
FLOCK_POINT_COUNT = 48
FLOCK_POINT_SIZE = 4
FLOCK_COLUMNS = FLOCK_POINTS + FLOCK_POINT_COUNT * FLOCK_POINT_SIZE
FLOCK_MEMORY_SIZE = FLOCK_COLUMNS + AZIMUTHS

# `pacnav` remembers paths on a common beat: number plus one, first and last beat, then positions in turn.
PACNAV_BEAT = LAW_MEMORY
PACNAV_SINCE_BEAT = LAW_MEMORY + 1
PACNAV_TARGET = LAW_MEMORY + 2
PACNAV_TARGET_P = LAW_MEMORY + 3
PACNAV_PATHS = LAW_MEMORY + 8
PACNAV_PATH_COUNT = 24
PACNAV_SAMPLES = 24
PACNAV_LAST_P = 4
PACNAV_AGE = 6
PACNAV_POSITIONS = 8
PACNAV_PATH_SIZE = PACNAV_POSITIONS + 2 * PACNAV_SAMPLES
PACNAV_COLUMNS = PACNAV_PATHS + PACNAV_PATH_COUNT * PACNAV_PATH_SIZE
PACNAV_MEMORY_SIZE = PACNAV_COLUMNS + AZIMUTHS

# The other laws only need room for one distance in each direction, and a state of their own.
PLAIN_STATE = LAW_MEMORY
PLAIN_COLUMNS = LAW_MEMORY + 8
PLAIN_MEMORY_SIZE = PLAIN_COLUMNS + AZIMUTHS

MEMORY_SIZE = PACNAV_MEMORY_SIZE
"""Enough for every law; `flock` uses the first `FLOCK_MEMORY_SIZE` of it."""

# Parameters of `flock`.
FLOCK_COHESION = 8
FLOCK_PURSUIT = 9
FLOCK_FAR = 10
FLOCK_FEED_FORWARD = 11
FLOCK_SEPARATION = 12
FLOCK_SEPARATION_REACH = 13
FLOCK_LEAD = 14
FLOCK_HEIGHT_GAIN = 15
FLOCK_TOP_WEIGHT = 16
FLOCK_BELOW = 17
FLOCK_DODGE = 18
FLOCK_DODGE_TIME = 19
FLOCK_DODGE_ROOM = 20
FLOCK_FLOW = 21
FLOCK_FLOW_REACH = 22
FLOCK_FLOW_TURN = 23
FLOCK_OBSTACLE_RATE = 24
FLOCK_OBSTACLE_MARGIN = 25
FLOCK_NEIGHBOUR_RATE = 26
FLOCK_NEIGHBOUR_MARGIN = 27
FLOCK_NEIGHBOUR_SHARE = 28
FLOCK_BAND_BELOW = 29
FLOCK_BAND_ABOVE = 30
FLOCK_SCAN_DELAY = 31
FLOCK_OBSTACLE_MEMORY = 32
FLOCK_NEIGHBOUR_MEMORY = 33
FLOCK_COAST = 34
FLOCK_BODY_RADIUS = 35
