from glob import glob

from setuptools import find_packages, setup

PACKAGE = 'lpv_node'

setup(
    name=PACKAGE,
    version='0.1.0',
    packages=find_packages(exclude=['test']),
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/' + PACKAGE]),
        ('share/' + PACKAGE, ['package.xml']),
        (f'share/{PACKAGE}/layout', glob('layout/*')),
    ],
    package_data={'lpv_node': ['*.xml'], 'lpv_node.view': ['static/*']},
    install_requires=['setuptools', 'aiohttp>=3.9'],
    extras_require={'test': ['pytest']},
    zip_safe=False,
    maintainer='lpv-arm-fdi maintainers',
    maintainer_email='maintainers@example.org',
    description='What nodes share, the recorder, and the live view.',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'recorder = lpv_node.recorder.main:main',
            'view = lpv_node.view.main:main',
        ]
    },
)
