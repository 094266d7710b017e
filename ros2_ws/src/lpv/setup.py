from setuptools import find_packages, setup

PACKAGE = 'lpv'

setup(
    name=PACKAGE,
    version='0.1.0',
    packages=find_packages(exclude=['test']),
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/' + PACKAGE]),
        ('share/' + PACKAGE, ['package.xml']),
    ],
    package_data={
        'lpv.campaign.report': ['*.html'],
        'lpv.cli': ['templates/*.yaml'],
        'lpv.core.serial_arm.certificate': ['claims_*.md'],
        'lpv.identify.results': ['*.html'],
        'lpv.report': ['*.css', '*.html'],
    },
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=False,
    maintainer='lpv-arm-fdi maintainers',
    maintainer_email='maintainers@example.org',
    description='Sensor-fault diagnosis of robot arms: the library and its commands.',
    license='Apache-2.0',
    entry_points={'console_scripts': ['lpv = lpv.cli.main:main']},
)
