"""Managed (lifecycle) nodes that start themselves, say why they cannot, and stop cleanly."""

import functools
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import rclpy
from rclpy.clock import Clock, ClockType, ROSClock
from rclpy.duration import Duration
from rclpy.exceptions import ParameterException
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from rclpy.timer import Timer

from lpv.core.support.errors import LpvError
from lpv.core.support.limits import PATIENCE
from lpv.core.support.options import Entry
from lpv.core.support.signals import StopRequest
from lpv_node.arguments import initialise, refused
from lpv_node.parameters import CheckedParameterService, declare, table

RCLError = rclpy_implementation.RCLError
VIEWER = 'view'
"""Name of the live view's node: the graph does not wait for it, nor start because of it."""

COMMON = table("""
autostart=true         configure and activate at start, without a lifecycle manager
lockstep               reliable topics with deep queues: every step waits for its answer
await_recorders=0[0:100]  wait until each output has this many recorders before taking part:
                       recordings are then complete from the first sample
""")


def served(act: Callable[[Any, Any, Any], str]) -> Callable[[Any, Any, Any], Any]:
    """A service's callback, whose answer is what a method says it did; LpvError: why it did not.

    Nodes that are not active refuse: what was asked for would act when nobody expects it.
    """

    @functools.wraps(act)
    def answer(node: Any, request: Any, response: Any) -> Any:
        try:
            if not node._taking_part:
                raise LpvError(f'{node.get_name()} is not active: nothing was done')
            response.message, response.success = act(node, request, response), True
            node.get_logger().info(f'{act.__name__.removeprefix("_on_")}: {response.message}')
        except LpvError as error:
            response.message = str(error)
        return response

    return answer


class ManagedNode(LifecycleNode):
    """Base of the graph's nodes.

    Subclasses implement ``setup`` (may raise LpvError, as may ``listen``: the message is logged and
    the transition fails), ``outputs`` (publishers and how many nodes of the graph consume each: in
    lockstep these must be matched first), ``begin`` and ``end``.  A loop of nodes that all wait for
    their outputs would never start: the one that makes the first step subscribes earlier, in
    ``listen``.
    Publishers, subscriptions, services and timers are destroyed without being named: those of
    ``setup`` when the node is cleaned up, those of ``listen`` and ``begin`` when it is deactivated.

    ``specs`` are parameters beside the common ones, ``tunable`` may be set while the node runs.
    After it was told to stop, it goes on until nothing has come for ``drain_time`` [s].
    """

    drain_time = 0.0

    def __init__(self, name: str, specs: Iterable[Entry], tunable: Iterable[Entry] = ()) -> None:
        super().__init__(name, start_parameter_services=False)
        self._checked_parameters = CheckedParameterService(self)
        declare(self, (*COMMON, *specs))
        tunable = tuple(tunable)
        declare(self, tunable, read_only=False)
        self._tunable = {one.name for one in tunable}
        self.add_post_set_parameters_callback(self._say_changes)
        self.lockstep = self.get_parameter('lockstep').value
        self.exit_code = 0
        self.finished = False  # set where the main loop is to stop
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._taking_part = False
        self._of_setup: set[Any] = set()
        self._of_activity: set[Any] = set()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle: read files and parameters."""
        if not self._made(self.setup, self._of_setup):
            self._take_down()
            return TransitionCallbackReturn.FAILURE
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle: take part in the graph as soon as the outputs are matched."""
        self._taking_part = True
        if not self._made(self.listen, self._of_activity):
            self._leave()
            return TransitionCallbackReturn.FAILURE
        self._gate = self.steady_timer(0.02, self._try_begin)
        self._of_activity.add(self._gate)
        return super().on_activate(state)

    def _made(self, make: Callable[[], None], created: set[Any]) -> bool:
        """Make a part of the node, noting what is created; False if it cannot be, and is logged."""
        try:
            with self._noting(created):
                make()
        except LpvError as error:
            self.get_logger().error(str(error))
            return False
        except Exception as error:
            # rclpy turns it into a state and forgets the reason.
            self.get_logger().fatal(f'{type(error).__name__}: {error}')
            raise
        return True

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle: stop taking part."""
        self._leave()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle: back to unconfigured."""
        self._take_down()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle: stop taking part for good; the process stays until it is told to end."""
        self._leave()
        self._take_down()
        return super().on_shutdown(state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle: a transition failed unexpectedly; back to unconfigured."""
        self._leave()
        self._take_down()
        super().on_error(state)
        return TransitionCallbackReturn.SUCCESS

    def _say_changes(self, parameters: list[Parameter]) -> None:
        """Log what was set while the node runs: alarms before and after depend on it."""
        for parameter in parameters:
            if parameter.name in self._tunable:
                self.get_logger().info(f'{parameter.name} is {parameter.value} now')

    def _leave(self) -> None:
        self._taking_part = False
        self._destroy(self._of_activity)
        self.end()

    def _take_down(self) -> None:
        """Destroy what `setup` created: configured twice, a node must not publish twice."""
        self.teardown()
        self._destroy(self._of_setup)

    @contextmanager
    def _noting(self, created: set[Any]) -> Iterator[None]:
        """Add what is created meanwhile to a set."""
        before = self._entities()
        try:
            yield
        finally:
            created |= self._entities() - before

    def _entities(self) -> set[Any]:
        return {*self.publishers, *self.services, *self.subscriptions, *self.timers}

    def _destroy(self, entities: set[Any]) -> None:
        while entities:
            entity = entities.pop()
            self.destroy_publisher(entity)  # each does nothing for an entity of another kind
            self.destroy_service(entity)
            self.destroy_subscription(entity)
            self.destroy_timer(entity)

    def _try_begin(self) -> None:
        recorders = self.get_parameter('await_recorders').value
        wanted = {p: recorders + self.lockstep * count for p, count in self.outputs().items()}
        waiting = [p.topic_name for p, count in wanted.items() if self._matched(p) < count]
        if waiting:
            asked = f' (await_recorders is {recorders}: is it running?)' if recorders else ''
            text = f'waiting for subscribers of {", ".join(waiting)}{asked}'
            self.get_logger().warning(text, throttle_duration_sec=5.0, skip_first=True)
            return
        self.destroy_timer(self._gate)
        with self._noting(self._of_activity):
            self.begin()

    def _matched(self, publisher: Publisher) -> int:
        """Subscribers of an output, without the live view and nodes with hidden names."""
        # The latter are the ros2 command's, or not known by name yet.  A recorder that subscribes
        # twice, to publishers with different QoS, is one subscriber.
        readers = self.get_subscriptions_info_by_topic(publisher.topic_name)
        others = [r for r in readers if r.node_name != VIEWER and not r.node_name.startswith('_')]
        # In DDS the first twelve bytes are those of the participant.
        nodes = {(r.node_namespace, r.node_name, *r.endpoint_gid[:12]) for r in others}
        return publisher.get_subscription_count() - len(readers) + len(nodes)

    def count_publishers(self, topic_name: str) -> int:
        """As rclpy does, which forgets that the name may be remapped."""
        return super().count_publishers(self.resolve_topic_name(topic_name))

    def elapsed(self) -> int:
        """A time that only differences of count [ns]: that of /clock if it is used, or steady."""
        clock = self.get_clock()
        told = isinstance(clock, ROSClock) and clock.ros_time_is_active and clock.now().nanoseconds
        return told or self._steady.now().nanoseconds  # also where nobody publishes /clock

    def has_time(self) -> bool:
        """Whether the node's clock tells a time; warns while it waits for the first one."""
        if not self.get_parameter('use_sim_time').value or self.get_clock().now().nanoseconds:
            return True
        text = 'use_sim_time is set, and /clock has told no time yet: waiting for it'
        self.get_logger().warning(text, throttle_duration_sec=5.0, skip_first=True)
        return False

    def steady_timer(self, period: float, callback: Callable[[], None]) -> Timer:
        """Create a timer with a period [s] on the steady clock, which runs whatever /clock does."""
        return self.create_timer(period, self._while_active(callback), clock=self._steady)

    def create_subscription(  # type: ignore[override]
        self,
        msg_type: type,
        topic: str,
        callback: Callable[[Any], None],
        qos_profile: QoSProfile | int,
        **options: Any,
    ) -> Subscription:
        """Subscribe as rclpy does; what arrives while the node is not active is dropped."""
        active = self._while_active(callback)
        return super().create_subscription(msg_type, topic, active, qos_profile, **options)

    def _while_active(self, callback: Callable[..., None]) -> Callable[..., None]:
        """A callback that does nothing while the node takes no part."""
        # Executors call what was queued before a subscription or timer was destroyed, too.

        @functools.wraps(callback)
        def guarded(*arguments: Any) -> None:
            if self._taking_part:
                callback(*arguments)

        return guarded

    def setup(self) -> None:
        """Read files and parameters, create publishers; may raise LpvError."""

    def progress(self) -> int:
        """A count that grows with every message that was received while stopping."""
        return 0

    def stopping(self) -> None:
        """The node was told to stop; it goes on until nothing comes for `drain_time`."""

    def outputs(self) -> dict[Publisher, int]:
        """Publishers, each with the number of graph nodes that consume it."""
        return {}

    def listen(self) -> None:
        """Create what must exist before the outputs are matched; may raise LpvError."""

    def begin(self) -> None:
        """Create subscriptions and timers."""

    def end(self) -> None:
        """Undo `listen` and `begin` beyond their subscriptions and timers; may be called twice."""

    def teardown(self) -> None:
        """Undo `setup` beyond its publishers, services and timers; may be called twice."""


def make_executor() -> Executor:
    """The executor of all nodes."""
    try:
        from rclpy.experimental import EventsExecutor
    except ImportError:  # older distributions
        return SingleThreadedExecutor()
    return EventsExecutor()


def run_node(node_class: Callable[[], ManagedNode]) -> int:
    """Run one managed node until it finishes or is told to stop; 1 if it could not start."""
    stop = StopRequest()
    node, code = None, 1
    try:
        initialise()
        try:
            node = node_class()
        except RCLError as error:  # of a name or namespace that nodes cannot have
            raise refused(error) from error
        code = _spin(node, stop)
    except (KeyboardInterrupt, SystemExit):  # told to stop while it started
        code = 0
    except (LpvError, ParameterException) as error:
        print(f'[{node_class.__name__}] {error}', file=sys.stderr, flush=True)
    finally:
        if node is not None:
            node.end()
            node.destroy_node()
        rclpy.try_shutdown()
    return code


def _spin(node: ManagedNode, stop: StopRequest) -> int:
    if node.get_parameter('autostart').value:
        steps = node.trigger_configure, node.trigger_activate
        if not all(step() == TransitionCallbackReturn.SUCCESS for step in steps):
            return 1
    stop.defer()
    executor = make_executor()
    executor.add_node(node)
    # A time-out lets Python see signals; without one EventsExecutor ignores them.
    while rclpy.ok() and not (node.finished or stop.is_set):
        executor.spin_once(timeout_sec=0.2)
    node.stopping()
    _drain(node, executor)
    if node.lockstep and node._of_setup:  # unconfigured, it has no outputs
        wait_for_readers(node.outputs())
    return node.exit_code


def wait_for_readers(publishers: Iterable[Publisher]) -> None:
    """Wait while readers that lag behind still need this process to send again.

    One that has died never answers: together all publishers wait no longer than one would.
    """
    limit = time.monotonic() + 2.0 * PATIENCE
    for publisher in publishers:
        left = max(limit - time.monotonic(), 0.0)
        publisher.wait_for_all_acked(Duration(seconds=left))


def _drain(node: ManagedNode, executor: Executor) -> None:
    """Process what is still queued: until nothing has come for the node's drain time."""
    now = time.monotonic()
    limit, quiet_since, progress = now + 2.0 * PATIENCE, now, node.progress()
    while rclpy.ok() and time.monotonic() < min(limit, quiet_since + node.drain_time):
        executor.spin_once(timeout_sec=0.05)
        if node.progress() != progress:
            quiet_since, progress = time.monotonic(), node.progress()
