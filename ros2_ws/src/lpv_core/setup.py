from setuptools import find_packages, setup

PACKAGE = 'lpv_core'

setup(
    name=PACKAGE,
    version='0.1.0',
    packages=find_packages(exclude=['test']),
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/' + PACKAGE]),
        ('share/' + PACKAGE, ['package.xml']),
    ],
    install_requires=['setuptools'],
    extras_require={'test': ['pytest'], 'mujoco': ['mujoco>=3.3.1,<4'], 'urdf': ['pin>=3.3,<5']},
    zip_safe=False,
    maintainer='lpv-arm-fdi maintainers',
    maintainer_email='maintainers@example.org',
    description='Arm model, observer, diagnosis and tracking of a two-link arm; free of ROS.',
    license='Apache-2.0',
)
