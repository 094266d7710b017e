import importlib.util

from setuptools import find_packages, setup

PACKAGE = 'lpv_ros2cli'
# A workspace on top of a real ros2cli must not hide its command.
SCRIPTS = [] if importlib.util.find_spec('ros2cli') else ['ros2 = lpv_ros2cli.main:main']

setup(
    name=PACKAGE,
    version='0.1.0',
    packages=find_packages(exclude=['test']),
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/' + PACKAGE]),
        ('share/' + PACKAGE, ['package.xml']),
    ],
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=False,
    maintainer='lpv-arm-fdi maintainers',
    maintainer_email='maintainers@example.org',
    description='The everyday part of the ros2 command, where there is no ros2cli.',
    license='Apache-2.0',
    entry_points={'console_scripts': SCRIPTS},
)
