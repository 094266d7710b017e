from glob import glob

from setuptools import find_packages, setup

PACKAGE = 'lpv_bringup'

setup(
    name=PACKAGE,
    version='0.1.0',
    packages=find_packages(exclude=['test']),
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/' + PACKAGE]),
        ('share/' + PACKAGE, ['package.xml']),
        (f'share/{PACKAGE}/arms', glob('arms/*')),
        (f'share/{PACKAGE}/campaigns', glob('campaigns/*')),
        (f'share/{PACKAGE}/columns', glob('columns/*')),
        (f'share/{PACKAGE}/config', glob('config/*')),
        (f'share/{PACKAGE}/gains', glob('gains/*')),
        (f'share/{PACKAGE}/launch', glob('launch/*')),
        (f'share/{PACKAGE}/requirements', glob('requirements/*')),
        (f'share/{PACKAGE}/scenarios', glob('scenarios/*')),
        (f'share/{PACKAGE}/urdf', glob('urdf/*')),
    ],
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=False,
    maintainer='lpv-arm-fdi maintainers',
    maintainer_email='maintainers@example.org',
    description='Launch files, arm files, gains, scenarios and parameters.',
    license='Apache-2.0',
)
