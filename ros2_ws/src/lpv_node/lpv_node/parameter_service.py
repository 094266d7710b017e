"""Parameter services that no request can end the node with."""

from collections.abc import Sequence

from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType, SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.parameter import Parameter
from rclpy.parameter_service import ParameterService


class CheckedParameterService(ParameterService):
    """rclpy's services without requests that end the process: of unknown types, or deletions."""

    def _set_parameters_callback(
        self, request: SetParameters.Request, response: SetParameters.Response
    ) -> SetParameters.Response:
        response.results = [self._set([message]) for message in request.parameters]
        return response

    def _set_parameters_atomically_callback(
        self, request: SetParametersAtomically.Request, response: SetParametersAtomically.Response
    ) -> SetParametersAtomically.Response:
        response.result = self._set(request.parameters)
        return response

    def _set(self, messages: Sequence[ParameterMessage]) -> SetParametersResult:
        for message in messages:
            if not message.name:
                return SetParametersResult(successful=False, reason='a parameter needs a name')
            if message.value.type == ParameterType.PARAMETER_NOT_SET:
                reason = f'{message.name} cannot be deleted'
                return SetParametersResult(successful=False, reason=reason)
        try:
            return self._get_node().set_parameters_atomically(
                [Parameter.from_parameter_msg(message) for message in messages]
            )
        except Exception as error:  # of any type: rclpy does not check what it is sent
            reason = f'{type(error).__name__}: {error}'
            return SetParametersResult(successful=False, reason=reason)
