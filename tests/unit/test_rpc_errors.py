"""What gRPC itself reports of a call becomes an error that says what to do."""

from __future__ import annotations

import grpc
import pytest
from grpc.aio import AioRpcError, Metadata

from pretouch.errors import Internal, PretouchError, Unavailable, from_rpc_error


@pytest.mark.parametrize(
    ("code", "detail", "kind"),
    [
        (grpc.StatusCode.INTERNAL, "Internal error from Core", Unavailable),
        (grpc.StatusCode.INTERNAL, "a defect", Internal),
        (grpc.StatusCode.UNAVAILABLE, "connection refused", Unavailable),
    ],
)
def test_a_call_that_ended_while_it_was_written_to_may_be_repeated(
    code: grpc.StatusCode, detail: str, kind: type[PretouchError]
) -> None:
    error = from_rpc_error(AioRpcError(code, Metadata(), Metadata(), detail))
    assert type(error) is kind
    assert kind is Internal or error.remedy
