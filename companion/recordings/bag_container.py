"""Messages in ROS bags of either generation, read through the library `rosbags`.

The library is loaded when a bag is opened and not before: what flies has no use for it. It raises many
kinds of errors on a damaged file; here they become one.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from companion.errors import LogError

BagKind = Literal["ROS 1 bag", "ROS 2 bag"]
Storage = Literal["rosbag1", "dir", ".db3", ".mcap"]


@dataclass(frozen=True, slots=True)
class BagTopic:
    """One topic of a bag.

    Attributes:
        name: such as "/livox/lidar".
        message_type: such as "sensor_msgs/msg/Imu".
        digest: name of the message's definition, empty if the bag does not tell.
    """

    name: str
    message_type: str
    digest: str


@dataclass(frozen=True, slots=True)
class BagMessage:
    """One message, still serialised.

    Attributes:
        t_ns: when it was recorded.
    """

    topic: BagTopic
    t_ns: int
    data: bytes


class BagContainer:
    """A bag on disk.

    Attributes:
        kind: its generation.
        cdr: whether its messages are serialised as CDR.
        topics: all of them.
    """

    def __init__(self, path: Path, storage: Storage) -> None:
        """Read what topics the bag has.

        Args:
            path: the file, or the folder of a ROS 2 bag.
            storage: how the messages are stored.

        Raises:
            LogError: if the library is missing or cannot read the bag.
        """
        self.kind: BagKind = "ROS 1 bag" if storage == "rosbag1" else "ROS 2 bag"
        self.cdr = storage != "rosbag1"
        self._path = path
        self._storage = storage
        with self._opened() as reader:
            self.topics = tuple(sorted({_topic(item) for item in reader.connections}, key=_name))

    def messages(self, *names: str) -> Iterator[BagMessage]:
        """Yield the messages of some topics in the order of recording.

        Raises:
            LogError: where the library cannot go on, after everything before was yielded.
        """
        with self._opened() as reader:
            connections = [item for item in reader.connections if item.topic in names]
            if not connections:
                return
            for connection, t_ns, data in reader.messages(connections, None, None):
                yield BagMessage(_topic(connection), t_ns, bytes(data))

    @contextmanager
    def _opened(self) -> Iterator[Any]:
        """Open the bag; whatever the library raises meanwhile is a LogError."""
        reader = None
        try:
            reader = _reader(self._path, self._storage)
            reader.open()
            yield reader
        except (LogError, GeneratorExit):
            raise
        except Exception as error:
            raise LogError(f"{self._path}: cannot be read as a {self.kind}: {_reason(error)}") from error
        finally:
            if reader is not None:
                _close(reader)


def _reader(path: Path, storage: Storage) -> Any:
    try:
        from rosbags import rosbag1, rosbag2
    except ImportError as error:
        raise LogError(
            f"{path}: reading ROS bags needs the package rosbags: pip install 'companion[recordings]'"
        ) from error
    if storage == "rosbag1":
        return rosbag1.Reader(path)
    # The library would choose by the file's name; the file's content has been looked at already.
    return rosbag2.Reader.STORAGE_PLUGINS[storage](path)


def _reason(error: Exception) -> str:
    if isinstance(error, MemoryError | OverflowError):
        return "a length in it is impossible"
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


def _close(reader: Any) -> None:
    try:
        reader.close()
    except Exception:
        # A reader that did not open cannot be closed either; what is wrong has been said.
        return


def _topic(connection: Any) -> BagTopic:
    return BagTopic(str(connection.topic), str(connection.msgtype), str(connection.digest or ""))


def _name(topic: BagTopic) -> str:
    return topic.name
