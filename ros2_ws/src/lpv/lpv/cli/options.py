"""The commands of ``lpv`` and their options; no command's module is imported for its help."""

from argparse import Namespace
from collections.abc import Iterable

from lpv.core.support.errors import ConfigError
from lpv.core.support.options import entries

_JOINTS = """
--joints JOINT+        joints of the arm, with spaces or commas; all others of the URDF are locked
--lock JOINT[=VALUE]*  hold a joint of the URDF, as a gripper's (at 0), or several with commas
                       [rad], [m]
--tip LINK             last link of the arm: its joints are those on the way to it
"""
_ARM = """
--urdf URDF!           URDF of the arm (xacro expanded)
| --arm ARM            arm file
"""
_OBSERVER = """
--arm ARM          arm file, or name of a shipped arm; the one that the gains were designed for, or
                   that the bag names, if not given
--gains GAINS      gains file of this arm, or name of shipped ones; those in the bag if any
| --requirement REQUIREMENT  requirement to design gains for, a file or a shipped one; without
                   both, the shipped one of the arm's name
--parameters FILE  parameter file of the node, for its diagnosis, initial_samples and max_gap
--from S:float[0:1e9]  leave out what is before this time, counted from the first message of the
                   bag [s]
--to S:float[0:1e9]  leave out what is at this time or later [s]
--topic TOPIC      topic of the measurements, where there are several
--effort-topic TOPIC  topic of torques to use in place of the measured efforts: TorqueCommand,
                   JointState, Float64MultiArray, JointTrajectory
--torque-source {effort,command}  torques as measured, or the recorded commands
"""
_EXECUTION = """
--out FOLDER         folder of the results (in out/, named like the command and what it runs); where
                     it holds a part of them, the rest is done
--workers N:int[0:1024]   processes on this machine; 0: this process only (default: one per core)
--scheduler ADDRESS  Dask scheduler to use instead, e.g. tcp://127.0.0.1:8786
"""
_PRESETS = '{zstd_fast,zstd_small,none}'

COMMANDS = {
    'design': """design certified gains for an arm
--map MAP.png              picture to write: smallest fault that is always detected, over the region
--arm ARM!                 arm file, or name of a shipped arm (paper, real_arm, ur10, panda)
--requirement REQUIREMENT  requirement file, or name of a shipped one (paper, paper_literal,
                           real_arm); without, the one with the arm's name
--proof                    also prove the inequalities in exact rational arithmetic
--out GAINS.yaml!          parameter file to write
# arms without an lpv region: certificate of computed torque (docs/tracking.md)
--bandwidth=10.0           distance of the three poles of every joint from zero [rad/s]
--model-error SHARE:float  relative error of each link's mass and inertia; default: as the arm file
                           states, or 0.05
--rate-share=0.0           region: share of all velocity limits at once; 0: as large as possible
""",
    'verify': """check the certificate of a gains file
gains      gains file as written by lpv design, or name of shipped ones
--arm ARM  arm that the gains are to be used with: file or name of a shipped one; without, the arm
           that the file itself describes
--proof    also prove the inequalities in exact rational arithmetic
""",
    'falsify': """search for healthy runs that cross a threshold
--arm ARM!              arm file, or name of a shipped arm
--gains GAINS           gains file, or name of a shipped one; two-link arms only
--evaluations=20000[1:1000000000]  runs; after Ctrl-C (code 130) the worst one so far is written
--duration=6.0[0.1:600]  of a run [s]
--seed=0                of the search
--repeat scenario.yaml  only run this attack again
--out=out/falsify       folder
""",
    'demo': """design, simulate with the real graph, record, report
--arm=paper            shipped arm or arm file
--requirement=paper    shipped requirement or file; arms without an lpv region need none
--scenario SCENARIO    shipped scenario or scenario file (two_faults, or that of the arm's name)
--mode {lockstep,realtime}  step on /clock as fast as the transport allows, reproducibly, or run on
                       the wall clock
--compensation {confirmed,off,always}  position in the tracking loop
--seed=-1              seed instead of the scenario's
--out=out/demo         folder for everything
--domain-id ID:int     ROS_DOMAIN_ID of the run; otherwise the environment's, or one of its own
""",
    'doctor': """find the usual mistakes in files, environment and graph
--arm ARM            arm file, or name of a shipped arm; without, that of the running observer
--gains GAINS        gains file that should fit the arm, or name of shipped ones
--scenario SCENARIO  scenario file, or name of a shipped one
--offline            leave the running graph alone
--seconds=3.0[0.5:600]        how long to watch the graph
--json               findings as JSON
""",
    'campaign': f"""run thousands of simulations, and report on them
campaign      campaign file (YAML) or name of a shipped one; or a folder of results: its report is
              written again, or with --run one of its runs as a bag
--no-report   put the results together, and write no report
--run N:int   do this run again, and write it as the bag that --bag names
--bag FOLDER  bag of the run to write
{_EXECUTION}""",
    'fleet': f"""replay an archive of bags, and report on all of them
archive DIR  every rosbag2 bag below this folder is replayed; code 3 says that one could not be read
--healthy    the arms were healthy: all alarms are false
{_EXECUTION}{_OBSERVER}""",
    'tune': f"""search the weights of a design by campaigns of runs
campaign        campaign of an arm with designed gains, file or shipped name; its first design is
                what the search begins from
--search FIELD=LOW:HIGH*  number of the requirement (observer.decay, controller.FIELD[0]) or of the
                diagnosis (diagnosis.sigmas) to search, on a logarithmic scale; at least one
--cost COLUMN=WEIGHT*  column of the results whose mean counts, and its weight; may be repeated
                (detection_delay=2, missed=1, unstable=1, fault_rms_before=0.5,
                fault_rms_during=0.5, tracking_rms_during=0.5)
--trials=40[1:10000]  designs to try
--seed=1        of the search
{_EXECUTION}""",
    'run': """start a node, as ros2 run does
package  ROS package (lpv_arm_sim, lpv_uio, lpv_tracker, lpv_node)
program  its program (simulator, uio, tracker, recorder, view)
rest...  passed on: --ros-args -p name:=value -r from:=to --params-file FILE
""",
    'identify': """identify an arm from recordings of its motion
recordings BAG|CSV+    recordings of the moving arm: rosbag2 folder, .mcap, .db3 or .csv
--out ARM.yaml         arm file to write
--report DIR           folder for the report with pictures
--name NAME            name of the arm (the URDF's, with that of the tip if it holds several arms)
--base-rpy ROLL PITCH YAW:float[-6.3:6.3]  how the base is mounted, z up if not given [rad]
--effort-unit {Nm,A}   unit of the efforts; A: gains are estimated
--gain K:float+        joint torque per unit of effort, one for all joints or one each
--without-gravity      efforts do not contain the torque that holds the weight (found from the data)
| --with-gravity       efforts contain it, whatever the data say
--topic TOPIC          topic of the joint states, if there are several
--second-encoder JOINT=NAME*  second position sensor of a joint, as a joint of the messages or a CSV
                       column
--columns MAP          column map of CSV files (a YAML file or a shipped one)
--train-share=0.6[0.2:0.9]  share of each recording that is fitted, the rest is held back
--refit                write the parameters of a fit to all samples, after the test
--test BAG|CSV*        recording to test on, instead of the part held back
--calibrate            the arm of --arm is known: find noise, steps and rates of its sensors and the
                       torque that its model misses, from some 10 s of any healthy motion;
                       parameters stay
| --payload            the arm of --arm is known: find mass and centre of its tool only
--known-mass KG:float[1e-9:1e9]  with --payload: mass of the tool, by which the scale of the arm
                       is corrected
"""
    + _ARM
    + _JOINTS,
    'excite': f"""plan a motion that identifies an arm well
--out FOLDER!       folder to create: trajectory.csv, trajectory.yaml, reference bag, scenario.yaml
--duration=30.0[5:600]  in seconds
--rate=100.0[10:2000]  samples per second
--center ANGLE:float[-1e3:1e3]+  middle of the motion (that of the joints' ranges) [rad]
--reach=1.5[0.05:3.2]  largest way of a joint from the middle [rad]
--speed-share=0.6[0.01:1]  share of the velocity limits that is used
--torque-share=0.8[0.01:1]  share of the torque limits that is used
--lowest Z:float[-1e3:1e3]  height above the base that joints and tip keep [m]
--radius R:float[0:1e3]  distance from the base's vertical axis that they keep within [m]
--trials=300[1:100000]  motions that are tried
--seed=1            of the search
{_ARM}{_JOINTS}""",
    'import-csv': """turn a CSV recording of an arm into a bag
csv                    file with a header line and one sample a line
--columns MAP!         column map: a YAML file, or the name of a shipped one (real_arm)
--out BAG!             bag to create
--topic=/joint_states  topic
--delimiter CHARACTER  between cells (comma, semicolon or tab, as the header has them)
""",
    'replay': f"""run observer and diagnosis offline on a bag
bag                rosbag2 directory, MCAP or sqlite3 file
--out=out/replay   bag to write; an earlier result of this command is replaced
--report FOLDER    folder for a report of the new bag
--inject FAULTS    YAML file with a list "faults" that is added to the measurements, or scenario:
                   shows what would be found; onsets, and all times that are printed, count from
                   the first measurement that is replayed, which is that after --from
--estimates-only   write estimates, alarms and diagnostics alone; otherwise all topics are copied
--preset {_PRESETS}  compression of the new bag
--publish          play the bag into the live graph, with /clock, and run nothing offline; needs
                   ROS 2
--rate RATE:float[1e-3:1e3]  with --publish: speed (1.0)
--loop             with --publish: again and again
--clock-rate CLOCK_RATE:float[0:1e4]  with --publish: messages on /clock per second of the bag, 0
                   for none (100.0)
--topics TOPIC+    with --publish: topics to play; all but the answers of the diagnosis if not given
--wait WAIT:float[0:1e6]  with --publish: longest time to wait for a subscriber before the first
                   message [s] (5.0)
{_OBSERVER}""",
    'view': """show the running graph: web page, Foxglove, markers
--arm=paper           shipped arm or arm file
--scenario SCENARIO   shipped scenario or scenario file whose path and obstacle are drawn
--namespace=/lpv      namespace of the graph
--address=127.0.0.1   where to listen; 0.0.0.0: everywhere, the buttons then need the token that is
                      printed, or the one in the environment variable LPV_VIEW_TOKEN
--port=8090           port of the page
--foxglove-port=8765  port of the Foxglove WebSocket protocol; 0: off
--domain-id ID:int    ROS_DOMAIN_ID of the graph; otherwise the environment's
""",
    'init': f"""write commented files of an arm to start from
folder?      where the files are written (this folder)
--name NAME  name of the arm (the URDF's, with that of the tip if it holds several arms; or my_arm)
--urdf URDF  URDF of the arm (xacro expanded)
{_JOINTS}""",
    'urdf': """print the URDF of an arm
--arm=paper  shipped arm or arm file
--out FILE   file to write instead of the terminal
""",
    'recover': f"""repair a bag that is cut off or damaged
bag        rosbag2 directory, or one MCAP or sqlite3 file, which is never changed; exit code 3 says
           that something was lost, 1 that nothing can be read
--out BAG  bag to create; without, BAG_recovered if BAG is damaged, and nothing if it is not
--preset {_PRESETS}  compression of the new bag
""",
    'compare': """compare the answers in two bags of one recording
bag              first bag: recorded, or a result of lpv replay
other            second bag, of the same measurements; what one bag does not hold (after lpv replay
                 --estimates-only) is taken from the other
--arm ARM        arm file, or name of a shipped arm; that of the first bag's gains, or the shipped
                 one that its messages name, if not given
--topic TOPIC    topic of the measurements, where there are several
--out FOLDER     folder for comparison.json and pictures
--json           print JSON in place of tables
--mise=0.05[0:1e9]  tolerated relative change of mean squared errors
--delay=0.02[0:1e9]  tolerated change of the times of an alarm [s]
--signal=0.001[0:1e9]  tolerated difference of estimates [rad], [rad/s], and of confidence
--flags=0.002[0:1e9]  tolerated share of samples with another mode, state or alarm
--missing=0.0[0:1e9]  tolerated share of answers that only one bag has
--exact          tolerate nothing: every bit of estimates, of times and confidence of alarms
""",
    'report': """write the report of a bag
bag                  rosbag2 directory or MCAP file
--arm ARM            arm file, or name of a shipped arm; if not given, the one that the gains
                     describe, or the shipped one that the recorded messages name
--gains GAINS        gains file that the run was answered with; the one in the bag if not given
--scenario SCENARIO  scenario whose path and obstacle are drawn; the one in the bag if not given
--topic TOPIC        topic of the measurements, where there are several
--out=out/report     folder for the report
""",
}
"""What a command does, and a table of its options as `lpv.core.support.options` has them."""
_ELSEWHERE = {'design': 'lpv_design.main', 'doctor': 'lpv.cli.doctor'}


def module_of(command: str) -> str:
    """Module whose ``run`` takes the arguments of a command and returns the exit code.

    Of all but the doctor, ``arm`` is the arm itself, where one is named, and ``arm_file`` its file.
    """
    return _ELSEWHERE.get(command, f'lpv.cli.commands.{command.replace("-", "_")}')


def refuse(arguments: Namespace, names: Iterable[str], reason: str) -> None:
    """ConfigError for the first of some options that is given and would be left out in silence."""
    table = COMMANDS[arguments.command].split('\n', 1)[1]
    defaults = {entry.name: entry.default for entry in entries(table)}
    for name in names:
        value, option = getattr(arguments, name), f'--{name.replace("_", "-")}'
        if not (value is None or value is False or value in ([], defaults[option])):
            raise ConfigError(option, reason)
