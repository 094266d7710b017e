"""The graph on which upstream's own tests run their commands, as far as our types allow."""

import rclpy
from geometry_msgs.msg import PointStamped
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Bool, Float64MultiArray, String
from std_srvs.srv import SetBool


class Talker(Node):
    """/chatter, a hidden topic, a latched one, and messages with stamps."""

    def __init__(self):
        super().__init__('talker')
        self._count = 0
        self._chatter = self.create_publisher(String, 'chatter', 10)
        self._hidden = self.create_publisher(String, '_hidden_chatter', 10)
        self._hello = self.create_publisher(String, 'hello', 10)
        self._flag = self.create_publisher(Bool, 'flag', 10)
        self._numbers = self.create_publisher(Float64MultiArray, 'numbers', 10)
        self._points = self.create_publisher(PointStamped, 'points', 10)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._latched = self.create_publisher(String, 'latched', latched)
        self._latched.publish(String(data='once'))
        self.create_timer(0.05, self._publish)

    def _publish(self):
        text = String(data=f'Hello World: {self._count}')
        self._count += 1
        self._chatter.publish(text)
        self._hidden.publish(text)
        self._hello.publish(String(data='hello'))
        self._flag.publish(Bool(data=True))
        self._numbers.publish(Float64MultiArray(data=[0.5, -1.0]))
        point = PointStamped()
        point.header.stamp = self.get_clock().now().to_msg()
        self._points.publish(point)


class EchoServer(Node):
    """A service, a hidden one, and parameters of which some are refused or can be deleted."""

    def __init__(self):
        super().__init__('echo_server', namespace='my_ns')
        self.create_service(SetBool, 'echo', self._answer)
        self.create_service(SetBool, '_echo', self._answer)
        self.declare_parameter('limited', 1.0)
        self.declare_parameter('int_param', 42, ParameterDescriptor(dynamic_typing=True))
        self.add_on_set_parameters_callback(self._check)

    def _answer(self, request, response):
        response.success, response.message = request.data, 'bazbar'
        return response

    def _check(self, parameters: list[Parameter]):
        refused = any(p.name == 'limited' and p.value > 2.0 for p in parameters)
        return SetParametersResult(successful=not refused, reason='too large' if refused else '')


def main():
    rclpy.init()
    executor = SingleThreadedExecutor()
    nodes = [Talker(), EchoServer(), LifecycleNode('test_lifecycle_node')]
    for node in nodes:
        executor.add_node(node)
    print('ready', flush=True)
    executor.spin()


if __name__ == '__main__':
    main()
