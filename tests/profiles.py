"""Wrong profiles of every kind: each must be refused in one line, by the loader and by the command line."""

GOOD = """\
vehicle:
  name: uav1
role: leader
leader:
  mission:
    waypoints_m: [[5.0, 0.0, 1.5]]
"""

# name -> (profile, what the refusal says after the file's name)
WRONG: dict[str, tuple[str | bytes, str]] = {
    "empty": ("", ":1:1: found an empty file"),
    "only a comment": ("# nothing\n", ":1:1: found an empty file"),
    "list at the top": ("- a\n", ":1:1: found a list of 1 item"),
    "text at the top": ("leader\n", ":1:1: found text 'leader'"),
    "not UTF-8": (b"vehicle:\n  name: \xe9t\xe9\n", ":2:9: found byte 0xe9"),
    "UTF-16": (GOOD.encode("utf-16"), ":1:1: found byte 0xff"),
    "tab": ("vehicle:\n\tname: a\n", ":2:1: found a tab"),
    "open bracket": (GOOD + "lidar: {lidar_ip: 192.168.1.101\n", ":8:1: not valid YAML"),
    "duplicate key": (GOOD + "role: follower\n", ":7:1: role: found the key a second time (first on line 3)"),
    "alias bomb": (
        "a: &a [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]\n"
        + "".join(
            f"{b}: &{b} [{', '.join(['*' + a] * 10)}]\n" for a, b in zip("abcdefg", "bcdefgh", strict=True)
        ),
        "values with aliases written out",
    ),
    "deep nesting": ("a: " + "[" * 4000, "levels of nesting"),
    "too large": ("#" * 300_000, ":1:1: found more than 262144 bytes"),
    "python object": (
        GOOD.replace("uav1", "!!python/object/apply:os.system [id]"),
        ":2:9: vehicle.name: found the tag",
    ),
    "two documents": (GOOD + "---\nrole: leader\n", ":7:1: found a second document"),
    "unknown key": (GOOD + "safty: {}\n", ":7:1: safty: unknown key, did you mean safety?"),
    "unknown nested key": (
        GOOD + "safety:\n  max_sped_mps: 1.0\n",
        ":8:3: safety.max_sped_mps: unknown key, did you mean max_speed_mps?",
    ),
    "misspelt required key": (
        GOOD.replace("vehicle", "vehicel"),
        ":1:1: vehicel: unknown key, did you mean vehicle?",
    ),
    "missing key": ("role: follower\n", ":1:1: vehicle: missing, allowed is a mapping with the keys name"),
    "missing name": (
        "vehicle: {}\nrole: follower\n",
        ":1:1: vehicle.name: missing, allowed is text of 1 to 32",
    ),
    "no value": ("vehicle:\nrole: follower\n", ":1:9: vehicle: found nothing (null), allowed is a mapping"),
    "wrong unit": (
        GOOD + "safety: {max_data_age_ms: 0.2}\n",
        ":7:27: safety.max_data_age_ms: found 0.2, allowed is a number from 50 to 200",
    ),
    "too fast": (
        GOOD + "safety: {max_speed_mps: 80}\n",
        ":7:25: safety.max_speed_mps: found 80, allowed is a number above 0 and at most 8",
    ),
    "not a number": (GOOD + "safety: {max_speed_mps: .nan}\n", ":7:25: safety.max_speed_mps: found .nan"),
    "infinite": (GOOD + "safety: {max_speed_mps: 1e400}\n", ":7:25: safety.max_speed_mps: found 1e400"),
    "number as text": (GOOD + "safety: {max_speed_mps: '1.0'}\n", "(write it without quotes)"),
    "unit as text": (
        GOOD + "safety: {max_speed_mps: 2 m/s}\n",
        ":7:25: safety.max_speed_mps: found text '2 m/s'",
    ),
    "octal": (GOOD + "autopilot: {system_id: 010}\n", ":7:24: autopilot.system_id: found '010'"),
    "fraction for an integer": (
        GOOD + "autopilot: {system_id: 1.5}\n",
        ":7:24: autopilot.system_id: found 1.5, allowed is an integer from 1 to 250",
    ),
    "on for a truth value": (
        GOOD + "log: {imu: on}\n",
        ":7:12: log.imu: found text 'on', allowed is true or false",
    ),
    "base 60": (GOOD + "safety: {max_altitude_m: 1:30}\n", ":7:26: safety.max_altitude_m: found text '1:30'"),
    "name with a slash": (GOOD.replace("uav1", "../../etc"), ":2:9: vehicle.name: found text '../../etc'"),
    "unknown role": (GOOD.replace("role: leader", "role: leeder"), "did you mean leader?"),
    "leader without mission": (
        "vehicle: {name: a}\nrole: leader\n",
        ":2:7: role: found 'leader' without a section",
    ),
    "follower with mission": (
        GOOD.replace("role: leader", "role: follower"),
        ":4:1: leader: found a mission for the role 'follower'",
    ),
    "leader with a law": (
        GOOD + "follower: {method: flock}\n",
        ":7:1: follower: found a law for the role 'leader', allowed it for the role 'follower' only",
    ),
    "follower faster than the limit": (
        "vehicle: {name: a}\nrole: follower\nsafety: {max_speed_mps: 1.0}\n",
        ":1:1: follower.command.max_speed_mps: found 2, allowed at most safety.max_speed_mps, 1",
    ),
    "follower recovers below the limit": (
        "vehicle: {name: a}\nrole: follower\nfollower: {command: {recovery_height_m: 0.2}}\n",
        ":3:41: follower.command.recovery_height_m: found 0.2, allowed from safety.min_altitude_m",
    ),
    "grid that no law knows": (
        "vehicle: {name: a}\nrole: follower\ngrid: {azimuths: 36}\n",
        ":3:18: grid.azimuths: found 36, allowed 72, which the followers' laws know",
    ),
    "unknown law": (
        "vehicle: {name: a}\nrole: follower\nfollower: {method: floc}\n",
        ":3:20: follower.method: found text 'floc', allowed is",
    ),
    "waypoint of two numbers": (
        GOOD.replace("[5.0, 0.0, 1.5]", "[5.0, 0.0]"),
        ":6:19: leader.mission.waypoints_m[0]: found a list of 2 items, allowed is a list of 3 items",
    ),
    "waypoint too high": (
        GOOD.replace("1.5]", "9.0]"),
        ":6:30: leader.mission.waypoints_m[0][2]: found 9, allowed from safety.min_altitude_m to",
    ),
    "faster than the limit": (
        GOOD + "    speed_mps: 1.5\nsafety: {max_speed_mps: 1.2}\n",
        ":7:16: leader.mission.speed_mps: found 1.5, allowed at most safety.max_speed_mps, 1.2",
    ),
    "climbs faster than the limit": (
        GOOD + "safety: {max_descent_mps: 0.3}\n",
        ":5:3: leader.mission.max_vertical_speed_mps: found 0.5, allowed at most safety.max_climb_mps and",
    ),
    "altitudes crossed": (
        GOOD + "safety: {min_altitude_m: 3.0, max_altitude_m: 2.0}\n",
        ":7:26: safety.min_altitude_m: found 3, allowed less than safety.max_altitude_m, 2",
    ),
    "source twice": (
        GOOD + "authorisation: {sources: [command, command]}\n",
        ":7:36: authorisation.sources[1]: found 'command' twice, allowed each source once",
    ),
    "no source": (
        GOOD + "authorisation: {sources: []}\n",
        ":7:26: authorisation.sources: found a list of 0 items",
    ),
    "unknown source": (
        GOOD + "authorisation: {sources: [mode_swich]}\n",
        ":7:27: authorisation.sources[0]: found text 'mode_swich', allowed is one of 'mode_switch'",
    ),
    "unknown source of odometry": (
        GOOD + "odometry: {source: extern}\n",
        ":7:20: odometry.source: found text 'extern', allowed is one of 'lidar_inertial', 'external'",
    ),
    "external odometry on the autopilot's port": (
        GOOD + "odometry: {source: external}\nexternal_odometry: {port: 14540}\n",
        ":8:27: external_odometry.port: found 14540, which the LiDAR or the autopilot uses, allowed another",
    ),
    "external odometry in an unknown frame": (
        GOOD + "external_odometry: {frames: [local_enu]}\n",
        ":7:30: external_odometry.frames[0]: found text 'local_enu', allowed is one of 'local_frd'",
    ),
    "external odometry in no frame": (
        GOOD + "external_odometry: {frames: []}\n",
        ":7:29: external_odometry.frames: found a list of 0 items",
    ),
    "external odometry lost before it is stale": (
        GOOD + "odometry: {external: {lost_after_s: 0.2}}\n",
        "odometry.external: lost_after_s must be more than stale_after_s",
    ),
    "external odometry stale between two messages": (
        GOOD + "odometry: {external: {min_rate_hz: 2.0}}\n",
        "odometry.external: stale_after_s must be at least the period of min_rate_hz",
    ),
    "address": (
        GOOD + "lidar: {lidar_ip: 192.168.1.300}\n",
        ":7:19: lidar.lidar_ip: '192.168.1.300' is not an IPv4",
    ),
    "link": (GOOD + "autopilot: {url: 'udp:14540'}\n", ":7:18: autopilot.url: 'udp:14540' is not a link"),
    "circle": ("extends: wrong.yaml\n", ":1:10: extends: 'wrong.yaml' extends this file in turn"),
    "base missing": ("extends: ../gone.yaml\n", ":1:10: extends: no such file"),
}
