"""Candidates and predictions <-> the messages of registrar.proto."""

from __future__ import annotations

from collections.abc import Sequence

from pretouch.errors import Internal
from pretouch.scan_prediction import Candidate, Prediction
from pretouch.trajectory import Trajectory
from pretouch.v1 import registrar_pb2 as pb
from pretouch.wire.common import array_from_proto, array_to_proto


def candidate_to_proto(candidate: Candidate) -> pb.CandidatePath:
    path = candidate.path
    return pb.CandidatePath(
        base_t_tip=array_to_proto(path.base_T_tip, "f8"),
        t=array_to_proto(path.t, "f8"),
        spans=[pb.Span(start=start, end=end) for start, end in candidate.spans],
    )


def candidate_from_proto(message: pb.CandidatePath) -> Candidate:
    path = Trajectory(
        array_from_proto(message.t, "candidate.t"), array_from_proto(message.base_t_tip, "candidate.base_t_tip")
    )
    return Candidate(path, tuple((span.start, span.end) for span in message.spans))


def predictions_to_proto(predictions: Sequence[Sequence[Prediction]]) -> pb.PredictScansResponse:
    flat = [prediction for each in predictions for prediction in each]
    return pb.PredictScansResponse(
        expected_errors=[prediction.expected_error for prediction in flat],
        expected_returns=[prediction.expected_returns for prediction in flat],
    )


def predictions_from_proto(message: pb.PredictScansResponse, candidates: Sequence[Candidate]) -> list[list[Prediction]]:
    """The predictions of each candidate.

    Raises:
        Internal: their number is not that of the candidates' pieces.
    """
    counts = [len(candidate.pieces) for candidate in candidates]
    if not len(message.expected_errors) == len(message.expected_returns) == sum(counts):
        raise Internal(
            f"The registrar predicted {len(message.expected_errors)} errors and {len(message.expected_returns)} shares "
            f"of returns for {sum(counts)} pieces of paths.",
            "Run the registrar and the orchestrator in the same version.",
        )
    flat = map(Prediction, message.expected_errors, message.expected_returns)
    return [[next(flat) for _ in range(count)] for count in counts]
