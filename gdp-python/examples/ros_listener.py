"""A ROS listener without ROS. GDP_KEYRING and GDP_SWITCH say as whom and where."""

import asyncio

import gdp


async def main() -> None:
    async with gdp.open() as session:
        async for message in session.ros_subscribe("/chatter"):
            print(message["data"], flush=True)


asyncio.run(main())
