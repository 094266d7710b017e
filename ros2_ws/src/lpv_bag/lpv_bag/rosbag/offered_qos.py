"""Quality of service as it is stored beside a topic."""

from rosbags.interfaces import (
    Connection,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)

_FOREVER = QosTime(2147483647, 4294967295)


def qos_profile(reliable: bool, transient_local: bool, depth: int) -> Qos:
    """Offered QoS as stored beside a topic."""
    return Qos(
        QosHistory.KEEP_LAST,
        depth,
        QosReliability.RELIABLE if reliable else QosReliability.BEST_EFFORT,
        QosDurability.TRANSIENT_LOCAL if transient_local else QosDurability.VOLATILE,
        _FOREVER,
        _FOREVER,
        QosLiveliness.AUTOMATIC,
        _FOREVER,
        False,
    )


def offered_qos(connection: Connection) -> list[Qos]:
    """QoS profiles with which a topic was offered when it was recorded; none of ROS 1 bags."""
    return list(getattr(connection.ext, 'offered_qos_profiles', None) or ())
