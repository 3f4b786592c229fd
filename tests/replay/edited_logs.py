"""Flight logs that are not as they were: cut, with messages left out or changed."""

from collections.abc import Callable
from io import FileIO
from pathlib import Path

from companion.logs.channels import BY_TOPIC, Channel
from companion.logs.codec import codec_of
from companion.logs.container import ContainerWriter
from companion.logs.container_reader import ContainerReader, RawAttachment, RawMessage, RawMetadata

Edit = Callable[[RawMessage], bytes | None]


def channel_of(item: RawMessage) -> Channel:
    return BY_TOPIC[item.channel.topic]


def unchanged(item: RawMessage) -> bytes | None:
    return item.data


def copy_log(
    path: Path,
    output: Path,
    edit: Edit = unchanged,
    *,
    until_ns: int | None = None,
    configuration: Callable[[str], str] | None = None,
) -> Path:
    """Copy a log; `edit` returns a message's new bytes, or None to leave it out."""
    ids: dict[str, int] = {}
    with FileIO(output, "x") as file:
        writer = ContainerWriter(file, chunk_bytes=65536, compression_level=1)
        for item in ContainerReader(path).items():
            if isinstance(item, RawMetadata):
                writer.add_metadata(item.name, item.values)
            elif isinstance(item, RawAttachment):
                text = item.data.decode()
                text = text if configuration is None else configuration(text)
                if text:
                    writer.add_attachment(item.name, item.media_type, text.encode())
            elif until_ns is None or item.t_ns < until_ns:
                data = edit(item)
                if data is None:
                    continue
                topic = item.channel.topic
                if topic not in ids:
                    codec = codec_of(channel_of(item))
                    ids[topic] = writer.add_channel(
                        topic,
                        codec.message_encoding,
                        schema_name=item.channel.schema_name,
                        schema_encoding=codec.schema_encoding,
                        schema=codec.schema,
                    )
                writer.add_message(ids[topic], item.sequence, item.t_ns, data)
        writer.finish()
    return output
