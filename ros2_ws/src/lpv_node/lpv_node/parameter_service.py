"""Parameter services that no request can end the node with."""

from collections.abc import Sequence

from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType, SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.exceptions import ParameterNotDeclaredException
from rclpy.parameter import Parameter
from rclpy.parameter_service import ParameterService

from lpv_node.parameters import QUOTE_WORDS


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
            if reason := self._wrong_type(message):
                return SetParametersResult(successful=False, reason=reason)
        node = self._get_node()
        try:
            return node.set_parameters_atomically(
                [Parameter.from_parameter_msg(message) for message in messages]
            )
        except ParameterNotDeclaredException:
            names = [m.name for m in messages if not node.has_parameter(m.name)]
            reason = f'{node.get_name()} has no parameter {", ".join(names)}'
            return SetParametersResult(successful=False, reason=reason)
        except Exception as error:  # of any type: rclpy does not check what it is sent
            reason = f'{type(error).__name__}: {error}'
            return SetParametersResult(successful=False, reason=reason)

    def _wrong_type(self, message: ParameterMessage) -> str:
        """Why a value is not of the type of its parameter; empty if it is, or may be."""
        node, given = self._get_node(), message.value.type
        if not node.has_parameter(message.name) or given not in [t.value for t in Parameter.Type]:
            return ''
        wanted = node.get_parameter(message.name).type_
        if node.describe_parameter(message.name).dynamic_typing or given == wanted.value:
            return ''
        reason = f'{message.name} is of type {wanted.name}, not {Parameter.Type(given).name}'
        is_word = (wanted, given) == (Parameter.Type.STRING, ParameterType.PARAMETER_BOOL)
        return f'{reason}; {QUOTE_WORDS}' if is_word else reason
