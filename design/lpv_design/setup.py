from setuptools import find_packages, setup

PACKAGE = 'lpv_design'

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
    description='Design of observer and controller gains by linear matrix inequalities.',
    license='Apache-2.0',
    entry_points={'console_scripts': ['design = lpv_design.main:main']},
)
