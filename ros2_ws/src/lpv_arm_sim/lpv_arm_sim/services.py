"""Services that inject and clear faults on the running simulator."""

from rclpy.node import Node

from lpv.core.simulation.arm_simulator import ArmSimulator
from lpv.core.simulation.faults import Fault
from lpv.core.support.errors import LpvError
from lpv_msgs.srv import ClearFaults, InjectFault


class FaultServices:
    """``~/inject_fault`` and ``~/clear_faults``."""

    def __init__(self, node: Node, plant: ArmSimulator) -> None:
        self._node, self._plant = node, plant
        node.create_service(InjectFault, '~/inject_fault', self.inject)
        node.create_service(ClearFaults, '~/clear_faults', self.clear)

    def inject(
        self, request: InjectFault.Request, response: InjectFault.Response
    ) -> InjectFault.Response:
        """Start a fault now, or say why not."""
        fault = Fault(
            request.sensor,
            request.kind,
            self._plant.time,
            request.duration,
            request.size,
            request.rate,
        )
        try:
            self._plant.injector.add(fault)
        except LpvError as error:
            response.success, response.message = False, str(error)
            return response
        response.success = True
        response.message = f'{fault.kind} on {fault.sensor} from {fault.onset:.3f} s on'
        self._node.get_logger().info('injected ' + response.message)
        return response

    def clear(
        self, request: ClearFaults.Request, response: ClearFaults.Response
    ) -> ClearFaults.Response:
        """Remove faults of one sensor or of all."""
        try:
            response.cleared = self._plant.injector.clear(request.sensor)
        except LpvError as error:
            response.success, response.message = False, str(error)
            return response
        response.success = True
        response.message = f'{response.cleared} faults cleared'
        self._node.get_logger().info(response.message)
        return response
