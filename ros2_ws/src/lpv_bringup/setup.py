from glob import glob

from setuptools import find_packages, setup

PACKAGE = 'lpv_bringup'
FOLDERS = (
    'arms', 'campaigns', 'columns', 'config', 'gains', 'launch', 'requirements', 'scenarios',
    'urdf')  # fmt: skip

setup(
    name=PACKAGE,
    version='0.1.0',
    packages=find_packages(exclude=['test']),
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/' + PACKAGE]),
        ('share/' + PACKAGE, ['package.xml']),
        *((f'share/{PACKAGE}/{name}', glob(f'{name}/*')) for name in FOLDERS),
    ],
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=False,
    maintainer='lpv-arm-fdi maintainers',
    maintainer_email='maintainers@example.org',
    description='Launch files, arm files, gains, scenarios and parameters.',
    license='Apache-2.0',
)
