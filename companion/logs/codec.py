"""Messages to bytes and back, for every channel."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from companion.logs import datagram_codec
from companion.logs.channels import Channel, Encoding
from companion.logs.foxglove_codec import FoxgloveCodec
from companion.logs.json_codec import JsonCodec


@dataclass(frozen=True, slots=True)
class Codec:
    """How one channel's messages become bytes.

    Attributes:
        message_encoding, schema_encoding: MCAP's names of both formats.
        schema: the schema, in `schema_encoding`.
        encode: message to bytes; the same message always gives the same bytes.
        decode: bytes to message; raises ValueError if they are not such a message.
    """

    message_encoding: str
    schema_encoding: str
    schema: bytes
    encode: Callable[[Any], bytes]
    decode: Callable[[bytes], object]


@lru_cache(maxsize=64)
def codec_of(channel: Channel) -> Codec:
    """Return the codec of a channel."""
    if channel.encoding is Encoding.DATAGRAMS:
        return Codec(
            channel.encoding.value,
            "text",
            datagram_codec.SCHEMA,
            datagram_codec.encode,
            datagram_codec.decode,
        )
    if channel.encoding is Encoding.FOXGLOVE:
        foxglove = FoxgloveCodec(channel.schema)
        return Codec("protobuf", "protobuf", foxglove.schema(), foxglove.encode, foxglove.decode)
    json = JsonCodec(channel.message_type)
    return Codec("json", "jsonschema", json.schema(channel.schema), json.encode, json.decode)
