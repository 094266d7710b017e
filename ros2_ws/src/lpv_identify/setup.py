from setuptools import find_packages, setup

PACKAGE = 'lpv_identify'

setup(
    name=PACKAGE,
    version='0.1.0',
    packages=find_packages(exclude=['test']),
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/' + PACKAGE]),
        ('share/' + PACKAGE, ['package.xml']),
    ],
    package_data={'lpv_identify.results': ['*.html']},
    install_requires=['setuptools', 'pin>=3.3,<5'],
    extras_require={'test': ['pytest']},
    zip_safe=False,
    maintainer='lpv-arm-fdi maintainers',
    maintainer_email='maintainers@example.org',
    description='From a recording to an arm: inertial parameters, friction, sensors, delays.',
    license='Apache-2.0',
)
